"""What the dashboard shows, as data: charts of named signals and probes, colours, words that mean trouble.

The recorder logs whatever the contract names; this table only says which of it stands on the first page.
A source is `Message.Signal` or `process/probe`; the first one that exists is taken, a series without any
is left out. Values are converted to the chart's unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

__all__ = [
    "CHARTS", "CYCLE", "JERK", "LANES", "POSITION", "Chart", "Level", "Series", "level_of", "probe_color",
    "state_color",
]  # fmt: skip

RED, ORANGE, YELLOW, GREEN = 0xF2555AFF, 0xF59B42FF, 0xF2C94CFF, 0x4CC38AFF
BLUE, VIOLET, WHITE, GREY = 0x4DA3FFFF, 0xB58CFFFF, 0xE6E6E6FF, 0x8A8F98FF
CYAN, ROSE, LIMIT = 0x39C5CFFF, 0xF78FB3FF, 0xC2494DFF  # LIMIT: what must not be crossed
PALETTE = (BLUE, GREEN, YELLOW, VIOLET, ORANGE, CYAN, ROSE, 0xA3D65CFF, 0xC9A26BFF, RED)

POSITION = "ODO_Motion.Position"
"""Default source of the timeline `position`."""

CYCLE = "ATO_Command"
"""Message whose frames count the cycles when there is no timing ring to tell them."""


@dataclass(frozen=True)
class Series:
    """One line of a chart. `color` is RGBA; the same quantity has the same colour in every chart."""

    name: str
    sources: tuple[str, ...]
    color: int
    width: float = 1.5
    step: bool = False  # held until the next value, as a receiver sees it
    sign: int = 1  # -1: drawn downwards


@dataclass(frozen=True)
class Level:
    """A limit or a nominal value as a straight line in a chart.

    `source` names it: `limits/<key of the scenario's verdict>`, `period/<process>` or `timeout/<Message>`;
    without one it is `value`, in the unit of the chart. `both`: at minus the value as well.
    """

    name: str
    source: str = ""
    value: float = 0.0
    both: bool = False


@dataclass(frozen=True)
class Chart:
    """One chart of a page (Drive, Law, Timing): its name, title, unit, lines and limits.

    `distance` asks for the same chart over the train's position. `column` is its place on the page, left (0)
    or right (1); `share` its part of that column's height. `limits` are those of its vertical axis; without
    them it fits the data.
    """

    path: str
    title: str
    unit: str
    series: tuple[Series, ...]
    distance: bool = False
    column: int = 0
    share: float = 1.0
    limits: tuple[float, float] | None = None
    page: str = "Drive"
    levels: tuple[Level, ...] = ()
    realtime: bool = False  # says nothing in lockstep, and is left out there


JERK = ("plant_sim/acceleration_mps2", "jerk_mps3", "m/s^3")
"""Recorded beside a process's probe: its jerk, as the verdict takes it (0.2 s average over 0.1 s)."""


# The viewer draws bus signals below probes: where lines coincide, the wider one below shows as a rim.
CHARTS: tuple[Chart, ...] = (
    Chart(
        "speed", "Speed", "km/h",
        (
            Series("permitted", ("ATP_Permission.PermittedSpeed",), RED, 2.0, step=True),
            Series("measured", ("ODO_Motion.Speed",), BLUE, 5.0),
            Series("reference", ("controller/reference_speed_mps", "ATO_Status.ReferenceSpeed"), YELLOW, 3.0),
            Series("true", ("plant_sim/speed_mps",), WHITE, 1.0),
        ),
        distance=True, share=3.0,
    ),
    Chart(
        "effort", "Effort at the wheels, braking downwards", "kN",
        (
            Series("available", ("TCU_Status.EffortAvailable",), GREY, 1.0),
            Series("pneumatic brake", ("BCU_Status.PneumaticEffort",), VIOLET, 2.0, sign=-1),
            Series("electrodynamic brake", ("BCU_Status.ElectrodynamicEffort",), CYAN, 4.0, sign=-1),
            Series("drive", ("TCU_Status.TractiveEffort",), GREEN, 1.5),
        ),
        share=2.4,
    ),
    Chart(
        "acceleration", "Acceleration", "m/s^2",
        (
            Series(
                "reference", ("controller/reference_acceleration_mps2", "ATO_Status.ReferenceAcceleration"),
                YELLOW, 3.0,
            ),
            Series("true", ("plant_sim/acceleration_mps2",), WHITE, 1.0),
        ),
        share=1.5, limits=(-1.5, 1.5),
    ),
    Chart(
        "speed_error", "Tracking error: reference minus measured speed", "m/s",
        (Series("speed error", ("controller/speed_error_mps", "ATO_Status.SpeedError"), YELLOW),),
        column=1, share=1.6, levels=(Level("limit of its rms", "limits/rms_speed_error_mps", both=True),),
    ),
    Chart(
        "demand", "Effort demand", "%",
        (Series("demand", ("ATO_Command.EffortDemand",), ORANGE, step=True),),
        column=1, share=1.3, limits=(-105.0, 105.0),
    ),
    Chart(
        "jerk", "Jerk", "m/s^3",
        (Series("true", ("plant_sim/jerk_mps3",), WHITE, 1.0),),
        column=1, share=1.3, levels=(Level("limit", "limits/jerk_mps3", both=True),),
    ),
    Chart(
        "response", "From due to sent", "us",
        (
            Series("controller", ("controller/response",), BLUE),
            Series("plant_sim", ("plant_sim/response",), GREEN),
        ),
        page="Timing", share=1.6, levels=(Level("period", "period/controller"),), realtime=True,
    ),
    Chart(
        "missed", "Missed cycles so far", "cycles",
        (
            Series("controller", ("controller/missed",), BLUE, 2.5, step=True),
            Series("plant_sim", ("plant_sim/missed",), GREEN, 1.5, step=True),
        ),
        page="Timing", share=1.0, levels=(Level("limit", "limits/max_deadline_misses"),), realtime=True,
    ),
    Chart(
        "signal_age", "Oldest signal that was used", "ms",
        (
            Series("controller: any input", ("ATO_Timing.WorstSignalAge",), BLUE, step=True),
            Series("drive: command", ("TCU_Status.CommandAge",), GREEN, step=True),
        ),
        page="Timing", share=1.6, levels=(Level("silence limit of the command", "timeout/ATO_Command"),),
    ),
)  # fmt: skip

LANES: tuple[str, ...] = (
    "ATO_Status.Mode",
    "ATO_Status.Supervision",
    "TCU_Status.State",
    "BCU_Status.State",
)
"""The states under the charts of the first page."""

ERROR_WORDS = ("EMERGENCY", "FAULT", "LOST", "OVERRUN", "WRONG", "INVALID", "ROLL_BACK", "MISSED", "ERROR")
WARNING_WORDS = (
    "WARNING", "OVERSPEED", "DEGRADED", "CUT", "REPEATED", "NO_NEW_DATA", "SLIP", "SLIDE", "STOPPED",
)  # fmt: skip
HARMLESS_WORDS = ("CLEARED", "RELEASE", "OK_SOME_LOST", "NO", "OFF")
IDLE_WORDS = (
    "OFF",
    "NO",
    "NONE",
    "STANDBY",
    "RELEASED",
    "RELEASE",
    "BOOT_UP",
    "INITIAL",
    "WAITING_FOR_INPUTS",
)
GOOD_WORDS = ("OK", "YES", "NORMAL", "READY", "OPERATIONAL", "HOLD", "HOLDING")


BUSY = (BLUE, VIOLET, YELLOW, CYAN)
"""Colours of states that are neither idle, good nor bad."""


def level_of(state: str, name: str = "") -> str:
    """INFO, WARN or ERROR: how loud a change of the signal `name` to `state` is."""
    if state in HARMLESS_WORDS:
        return "INFO"
    text = state if state not in {"YES", "APPLY"} else name.upper()
    if any(word in text for word in ERROR_WORDS):
        return "ERROR"
    return "WARN" if any(word in text for word in WARNING_WORDS) else "INFO"


def state_color(state: str, position: int, name: str = "") -> int:
    """RGBA of a state's lane; `position` is its place in the value table."""
    level = level_of(state, name)
    if level != "INFO":
        return RED if level == "ERROR" else ORANGE
    if state in IDLE_WORDS:
        return GREY
    return GREEN if state in GOOD_WORDS else BUSY[position % len(BUSY)]


PROBE_COLORS = (
    ("reference_", YELLOW), ("measured_", BLUE), ("permitted_", RED), ("estimated_", CYAN),
    ("speed_error", YELLOW), ("effort_demand", ORANGE), ("feed_forward", GREY), ("integral", VIOLET),
    ("feedback", ORANGE), ("traction_", GREEN), ("electrodynamic_", CYAN), ("pneumatic_", VIOLET),
    ("resistance", ROSE), ("speed_mps", WHITE), ("position_m", WHITE), ("acceleration_mps2", WHITE),
    ("jerk_mps3", WHITE),
)  # fmt: skip
"""Colours of inner values by the start of their name: those of the same quantity elsewhere."""


def probe_color(name: str) -> int | None:
    """RGBA of a probe; None where any colour will do."""
    return next((color for start, color in PROBE_COLORS if name.startswith(start)), None)


def colors(count: int) -> Sequence[int]:
    """Colours for lines that nobody named one for; each round through the palette is darker."""
    return [_darker(PALETTE[k % len(PALETTE)], 0.6 ** (k // len(PALETTE))) for k in range(count)]


def _darker(rgba: int, factor: float) -> int:
    red, green, blue, alpha = rgba.to_bytes(4, "big")
    return int.from_bytes((round(red * factor), round(green * factor), round(blue * factor), alpha), "big")
