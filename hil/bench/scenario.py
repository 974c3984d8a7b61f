"""A scenario: one TOML file that says which train runs where, under which law, and what passes.

The file has one table per reader. `[journey]` is read by both nodes and the bench, `[controller]`
and `[plant]` by their node alone, `[bus]`, `[timing]` and `[verdict]` by the bench. The bench
validates all of them before it starts anything: the nodes' tables through the entry points
`hil.node.configuration`, so that it need not import the nodes.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field

from hil.bench.errors import ScenarioError
from hil.railway import Journey, load_journey
from hil.railway.files import read_toml, validate
from hil.railway.library import find_scenario

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Tables = dict[str, Any]


class Limits(BaseModel):
    """The table `[verdict]`: what a run must hold to pass. SI units.

    `jerk_mps3` is judged on the 0.2 s moving average of the acceleration, differenced over 0.1 s.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    stop_error_m: Positive = 0.3
    rms_speed_error_mps: Positive = 0.05
    overspeed_mps: Positive = 0.3
    jerk_mps3: Positive = 1.0
    trip_time_error_s: Positive = 2.0
    max_interventions: Annotated[int, Field(ge=0)] = 0
    """How often the supervision may take over (modes DEGRADED and EMERGENCY)."""
    max_deadline_misses: Annotated[int, Field(ge=0)] = 3
    max_consecutive_deadline_misses: Annotated[int, Field(ge=0)] = 1


class BusTable(BaseModel):
    """The table `[bus]`: the scenario's own bus; the command line wins over it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    interface: str | None = None
    channel: str | None = None
    bitrate: Annotated[int, Field(gt=0)] | None = None
    data_bitrate: Annotated[int, Field(gt=0)] | None = None
    """Of CAN FD frames with bit-rate switch [bit/s]."""
    loss_probability: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Frames lost on purpose, seeded by `journey.seed`; in lockstep within one process only."""


class TimingTable(BaseModel):
    """The table `[timing]`: how the nodes keep time in real time, and what an overload does.

    An overload is a release that comes before the work of the cycle before it has ended. The node skips
    whole cycles and keeps its phase; above a limit it halts with safe outputs. What a run may miss and still
    pass is `[verdict]`. The options are those of Simulink Real-Time's task overload.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    startup_grace_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.2
    """Overloads so soon after a node's first cycle are counted apart and never halt it."""
    max_overloads: Annotated[int, Field(ge=0)] | None = None
    """In all, per node. None: it never halts."""
    max_consecutive_overloads: Annotated[int, Field(ge=0)] | None = None
    spin_us: Annotated[int, Field(ge=0)] | Literal["auto"] = "auto"
    """For how long before a deadline a node polls the clock; 0: it only sleeps."""
    rehearsal: bool = True
    """Whether a twin of each unit runs before each deadline, so that the caches are warm."""
    controller_cpu: Annotated[int, Field(ge=0)] | Literal["auto", "any"] = "auto"
    """The CPU that the controller has for itself, the bench's other processes keep off it; `auto`: the last
    one, if there are two or more and SCHED_FIFO is granted; `any`: as the kernel likes."""

    def arguments(self) -> list[str]:
        """The command line of a node that keeps time like this."""
        arguments = ["--overload-grace", repr(self.startup_grace_s), "--spin-us", str(self.spin_us)]
        if self.max_overloads is not None:
            arguments += ["--max-misses", str(self.max_overloads)]
        if self.max_consecutive_overloads is not None:
            arguments += ["--max-consecutive-misses", str(self.max_consecutive_overloads)]
        return arguments if self.rehearsal else [*arguments, "--no-rehearsal"]


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_: Annotated[int, Field(alias="schema", ge=1, le=1)]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]+$")]
    title: str = ""
    source: str = ""
    journey: Tables
    controller: Tables = Field(default_factory=dict)
    plant: Tables = Field(default_factory=dict)
    bus: BusTable = BusTable()
    verdict: Limits = Limits()
    timing: TimingTable = TimingTable()


@dataclass(frozen=True)
class Scenario:
    """A validated scenario with its overrides applied."""

    path: Path  # the file the user named
    name: str
    title: str
    limits: Limits
    bus: BusTable
    timing: TimingTable
    journey: Journey
    tables: Tables = field(repr=False)  # the whole file, overrides applied, paths absolute
    configurations: Mapping[str, Any] = field(repr=False)  # by node, as the node itself reads its table

    @property
    def controller_period_s(self) -> float:
        """Period of the controller's cycle [s]."""
        return float(self.configurations["controller"].period_s)

    @property
    def plant_period_s(self) -> float:
        """Period of the plant's cycle [s]."""
        return float(self.configurations["plant_sim"].period_s)

    @property
    def law(self) -> str:
        """Name of the control law."""
        return str(self.configurations["controller"].law)

    def write(self, path: Path) -> None:
        """Write the resolved scenario, which is what the nodes read."""
        path.write_text(tomli_w.dumps(self.tables), encoding="utf-8")


def load_scenario(name_or_path: str, overrides: Sequence[str] = (), *, scratch: Path) -> Scenario:
    """Read, override and validate a scenario; `scratch` is a folder for the resolved copy.

    `overrides` are `dotted.key=value` with a TOML value (a bare word is taken as text).
    Raises ScenarioError or RailwayDataError: one line with file, key, value and limit.
    """
    path = find_scenario(name_or_path)
    tables = read_toml(path)
    for override in overrides:
        _override(tables, override)
    parsed = validate(_File, tables, path)
    tables.setdefault("controller", {})
    tables.setdefault("plant", {})
    _absolute_paths(tables, path.parent)
    resolved = scratch / "scenario.toml"
    resolved.write_text(tomli_w.dumps(tables), encoding="utf-8")
    journey = _as_of(path, resolved, partial(load_journey, resolved))
    configurations: dict[str, Any] = {}
    for entry in entry_points(group="hil.node.configuration"):
        configuration = entry.load()
        configurations[entry.name] = _as_of(path, resolved, partial(configuration.load, resolved))
    return Scenario(
        path=path,
        name=parsed.name,
        title=parsed.title,
        limits=parsed.verdict,
        bus=parsed.bus,
        timing=parsed.timing,
        journey=journey,
        tables=tables,
        configurations=configurations,
    )


def _as_of(path: Path, resolved: Path, load: Any) -> Any:
    """Run a loader on the resolved copy, and let its errors name the file that the user wrote."""
    try:
        return load()
    except ValueError as error:
        if not hasattr(error, "exit_code"):
            raise
        raise ScenarioError(str(error).replace(str(resolved), str(path))) from None


def _override(tables: Tables, override: str) -> None:
    key, separator, text = override.partition("=")
    parts = [part.strip() for part in key.split(".")]
    if not separator or not all(parts):
        raise ScenarioError(f"--set {override}: expected dotted.key=value, for example controller.law=pid")
    table: Any = tables
    for depth, part in enumerate(parts[:-1]):
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise ScenarioError(f"--set {override}: {'.'.join(parts[: depth + 1])} is a value, not a table")
    table[parts[-1]] = _toml_value(text.strip())


def _toml_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _absolute_paths(tables: Tables, folder: Path) -> None:
    """A line or train given as a file stays found when the resolved copy lies elsewhere."""
    journey: Mapping[str, Any] = tables["journey"]
    for key in ("line", "train"):
        value = journey.get(key)
        if isinstance(value, str) and value.endswith((".toml", ".json")):
            tables["journey"][key] = str((folder / value).resolve())
