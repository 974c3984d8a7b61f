"""The figures of the Fuzzy-D study: the paper's Fig. 11 and 13 to 16, and the same controllers on a train."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from studies.figure import Figure, Floats, Line, Panel, Role
from studies.fuzzy_d_laws import TITLES
from studies.fuzzy_d_plant import RAMP_M, STOP_M, Run, additional_resistance_n_per_kn, reference_speed
from studies.fuzzy_d_train import TrainRun

__all__ = ["figures"]

ROLES: Mapping[str, Role] = {"pid": "a", "speedt": "b", "fuzzy_d": "c"}
SPEED = "speed [m/s]"


def figures(runs: Mapping[str, Run], trains: Mapping[str, TrainRun]) -> list[Figure]:
    """All figures, from the runs on the paper's plant and those on the train."""
    return [
        _resistance(),
        _over_time("fig13_pid_speedt", "PID and SpeedT over time", "Fig. 13", runs, ("pid", "speedt")),
        _over_time(
            "fig14_speedt_fuzzy_d", "SpeedT and Fuzzy-D over time", "Fig. 14", runs, ("speedt", "fuzzy_d")
        ),
        _over_distance(
            "fig15_pid_speedt", "PID and SpeedT over distance", "Fig. 15", runs, ("pid", "speedt")
        ),
        _over_distance(
            "fig16_speedt_fuzzy_d", "SpeedT and Fuzzy-D over distance", "Fig. 16", runs, ("speedt", "fuzzy_d")
        ),
        _effort(runs),
        _train(trains),
    ]


def _line(name: str, x: Floats, y: Floats) -> Line:
    return Line(TITLES[name], ROLES[name], x, y)


def _reference() -> Line:
    x = np.arange(0.0, STOP_M + 60.0, 0.1)
    return Line("reference", "reference", x, np.array([reference_speed(p, RAMP_M)[0] for p in x]))


def _resistance() -> Figure:
    x = np.arange(0.0, STOP_M, 1.0)
    y = np.array([additional_resistance_n_per_kn(p) for p in x])
    panel = Panel("Gradient and curve", "Fc1 [N/kN]", [Line("Fc1", "disturbance", x, y, step=True)])
    return Figure(
        "fig11_resistance", "Additional resistance", "position_m", "position [m]", [panel], "Fig. 11"
    )


def _over_time(name: str, title: str, paper: str, runs: Mapping[str, Run], names: tuple[str, ...]) -> Figure:
    """The whole run, and every change of speed."""
    lines = [_line(law, runs[law].time_s, runs[law].speed_mps) for law in names]
    first = runs[names[0]]
    lines.append(Line(f"reference of {TITLES[names[0]]}", "reference", first.time_s, first.reference_mps))
    changes = [runs[law].time_s[np.nonzero(np.diff(runs[law].reference_mps))[0]] for law in names]
    curve, out = (float(changes[0][np.argmax(changes[0] > t)]) for t in (20.0, 90.0))
    stop = min(float(times[np.argmax(times > 125.0)]) for times in changes)  # the fastest one stops first
    end = float(first.time_s[-1])
    panels = [
        Panel(detail, SPEED, lines, x, y)
        for detail, x, y in (
            ("Whole run", (0.0, end), (-4.0, 18.0)),
            ("Start", (0.0, 15.0), (0.0, 18.0)),
            ("Into the curve and out of it", (curve - 4.0, out + 12.0), (9.0, 17.0)),
            ("Stop", (stop - 2.0, end), (-4.0, 16.0)),
        )
    ]
    return Figure(name, title, "time_s", "time [s]", panels, paper, columns=2)


def _over_distance(
    name: str, title: str, paper: str, runs: Mapping[str, Run], names: tuple[str, ...]
) -> Figure:
    """The whole run and the five details that the paper shows."""
    lines = [_line(law, runs[law].position_m, runs[law].speed_mps) for law in names] + [_reference()]
    fine = "fuzzy_d" in names
    steady = (14.65, 15.05) if fine else (14.5, 15.3)
    details: tuple[tuple[str, tuple[float, float], tuple[float, float]], ...] = (
        ("Whole run", (0.0, STOP_M + 50.0), (-4.0, 18.0)),
        ("Start", (0.0, 40.0 if fine else 150.0), (0.0, 18.0)),
        ("Static error, climb of 6 permille from 200 m", (150.0, 500.0), steady),
        ("Into the curve", (980.0, 1060.0), (8.0, 16.0)),
        ("Out of the curve", (1490.0, 1560.0), (9.5, 17.0)),
        ("Stop", (1985.0, 2010.0 if fine else 2040.0), (-2.0, 16.0)),
    )
    panels = [Panel(detail, SPEED, lines, x, y) for detail, x, y in details]
    return Figure(name, title, "position_m", "position [m]", panels, paper, columns=2)


def _effort(runs: Mapping[str, Run]) -> Figure:
    """Not in the paper: what the three ask of the train."""
    panels = []
    for title, unit, series, limits in (
        ("Acceleration of the train", "|a| [m/s^2]", "acceleration_mps2", (0.03, 100.0)),
        ("Control", "|u| [1]", "control", (1.0, 1e4)),
    ):
        lines = [
            Line(TITLES[name], ROLES[name], run.time_s, np.maximum(np.abs(getattr(run, series)), 1e-6))
            for name, run in runs.items()
        ]
        if series == "acceleration_mps2":
            end = np.array([0.0, 12.0])
            lines.append(Line("full service of a train, 1.3 m/s^2", "limit", end, np.array([1.3, 1.3])))
        panels.append(Panel(title, unit, lines, (0.0, 12.0), limits, log_y=True))
    return Figure("effort", "What the controllers ask for at the start", "time_s", "time [s]", panels)


def _train(trains: Mapping[str, TrainRun]) -> Figure:
    """Not in the paper: the same gains on a train."""
    lines, commands = [], []
    for name in ("pid", "speedt", "fuzzy_d"):
        run = trains[f"{name}, 100 m early"]
        lines.append(_line(name, run.position_m, run.speed_mps))
        commands.append(_line(name, run.position_m, run.command_mps2))
    bare = trains["pid, no anti-windup"]
    lines.append(Line("PID without anti-windup, reference at 2 km", "d", bare.position_m, bare.speed_mps))
    early = trains["pid, 100 m early"]
    lines.append(Line("reference, 100 m early", "reference", early.position_m, early.reference_mps))
    ends = np.array([0.0, STOP_M])
    limits = [
        Line(f"{what} of the train", "limit", ends, np.full(2, most))
        for what, most in (("full traction", 1.05), ("full service brake", -1.3))
    ]
    return Figure(
        "on_a_train",
        "The same gains on a train of 160 t",
        "position_m",
        "position [m]",
        [
            Panel("Speed", SPEED, lines, (0.0, STOP_M + 110.0), (0.0, 22.0)),
            Panel("Command", "acceleration [m/s^2]", [*commands, *limits], (0.0, STOP_M + 110.0)),
        ],
    )
