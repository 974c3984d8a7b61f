"""The replay itself: build the node, put the recorded bus to it, compare what it says."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from hil.bench.replay.comparison import Comparison, compare
from hil.bench.replay.cycles import Cycles, cycles_of_frames, cycles_of_recording
from hil.bench.replay.recorded import Place, Recorded, ReplayError, find_log, read_recorded
from hil.bench.replay.restbus import RecordedClock, RestbusLink, Said
from hil.bench.replay.rules import HALF_A_STEP, REAL_TIME_STEPS, STAMPS_ONLY_STEPS, Rules, load_rules
from hil.bench.scenario import Scenario, load_scenario
from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.node.cycle import Node
from hil.node.inbox import bus_identifier
from hil.node.lockstep import LockstepError
from hil.node.process import build_node, receive_ids
from hil.node.unit import Unit, every_cycle

__all__ = [
    "REPLAYABLE",
    "SCENARIO_FILE",
    "LiveFigures",
    "ReplayRequest",
    "Replayed",
    "Show",
    "load_unit",
    "replay",
]

REPLAYABLE = ("controller", "plant_sim")
SCENARIO_FILE = "scenario.toml"
CYCLES_BETWEEN_LOOKS = 200
NS_PER_S = 1e9

Show = Callable[[float], None]
"""Called now and then with the share of the recording that has been replayed, 0 to 1."""


@dataclass(frozen=True)
class ReplayRequest:
    """What to replay. `log`: a run directory or a frame log. `scenario`: a name or a file, default the one
    beside the log; `overrides` are `dotted.key=value`. `tolerances` and `ignore`: see `load_rules`.
    """

    log: Path
    node: str = "controller"
    scenario: str | None = None
    overrides: Sequence[str] = ()
    tolerances: Sequence[str] = ()
    ignore: Sequence[str] = ()
    rules: Path | None = None
    dbc: Path | None = None


@dataclass(frozen=True)
class LiveFigures:
    """A replay to a device on a bus: how late the restbus was [us], what does not count [s], frames the bus
    lost, and whether the user ended it early.
    """

    bus: str
    late_p50_us: float
    late_p99_us: float
    late_max_us: float
    settle_s: float
    dropped: int
    stopped: bool


@dataclass(frozen=True)
class Replayed:
    """How it went. `scenario`: None for a device that was played to from a log alone. `instants` says where
    the times of the cycles are from.
    """

    place: Place
    scenario: Scenario | None
    node: str
    lockstep: bool
    instants: str
    cycles: int
    duration_s: float
    wall_s: float
    restbus_frames: int
    left_out: int
    rules: Rules
    comparison: Comparison
    live: LiveFigures | None = None

    @property
    def mode(self) -> str:
        """How the recording was put to the node: `live` (a device on a bus), `lockstep` or `real-time`."""
        return "live" if self.live is not None else "lockstep" if self.lockstep else "real-time"

    @property
    def title(self) -> str:
        """What it is a run of, in words."""
        return self.place.log.name if self.scenario is None else self.scenario.name


def replay(request: ReplayRequest, *, show: Show = lambda share: None) -> Replayed:
    """Put a recorded log to one node and compare its answers.

    Raises ReplayError and the errors of a scenario, a contract or a log that is wrong.
    """
    if request.node not in REPLAYABLE:
        raise ReplayError(f"--node {request.node}: no such node; there are {', '.join(REPLAYABLE)}")
    place = find_log(request.log)
    contract = Contract.load(request.dbc)
    with tempfile.TemporaryDirectory(prefix="hil-") as scratch:
        scenario, unit = load_unit(request, place, contract, Path(scratch))
        recorded = read_recorded(place.log, contract, unit.nodes)
        rules = load_rules(request.rules, request.tolerances, request.ignore, contract)
        play = _lockstep if recorded.lockstep else _real_time
        begin = time.monotonic()
        played = play(unit, recorded, contract, scenario, place, show)
        wall_s = time.monotonic() - begin
    rules = rules.with_default(played.steps)
    codecs = [codec for node in unit.nodes for codec in contract.sent_by(node)]
    comparison = compare(
        codecs,
        played.recorded,
        played.node_said,
        rules,
        event_window_ns=0 if recorded.lockstep else unit.period_ns,
        neighbours=0 if recorded.lockstep else 1,
    )
    return Replayed(
        place=place,
        scenario=scenario,
        node=request.node,
        lockstep=recorded.lockstep,
        instants=played.instants,
        cycles=played.cycles,
        duration_s=(recorded.own[-1][1].timestamp_ns - recorded.start_ns) / NS_PER_S,
        wall_s=wall_s,
        restbus_frames=len(recorded.others),
        left_out=recorded.left_out,
        rules=rules,
        comparison=comparison,
    )


def load_unit(
    request: ReplayRequest, place: Place, contract: Contract, scratch: Path, otherwise: str = ""
) -> tuple[Scenario, Unit]:
    """What the log is a run of, and its unit as it is today; the scenario lies in `scratch` afterwards.

    Raises ReplayError where nobody says what it is a run of (`otherwise`: what else can be done then), and
    the errors of a scenario.
    """
    source = request.scenario or (str(place.scenario) if place.scenario is not None else None)
    if source is None:
        raise ReplayError(
            f"{place.log}: no scenario.toml beside it; say with --scenario what it is a run of{otherwise}"
        )
    scenario = load_scenario(source, request.overrides, scratch=scratch)
    build = next(e for e in entry_points(group="hil.node.unit") if e.name == request.node).load()
    unit: Unit = build(scratch / SCENARIO_FILE, contract)
    return scenario, unit


@dataclass(frozen=True)
class _Played:
    recorded: list[Said]
    node_said: list[Said]
    instants: str
    cycles: int
    steps: float


def _lockstep(
    unit: Unit, recorded: Recorded, contract: Contract, scenario: Scenario, place: Place, show: Show
) -> _Played:
    """Tick by tick, as the log says; every tick has its frames in the log's order."""
    tick_ns = round(min(scenario.controller_period_s, scenario.plant_period_s) * NS_PER_S)
    sync = contract.message("SYNC")
    sync_id = bus_identifier(sync)
    places, ticks_ns = [-1], [0]
    for where, frame in recorded.others:
        if frame.can_id == sync_id and len(frame.data) == sync.length:
            places.append(where)
            ticks_ns.append(int(sync.decode(frame.data)["Tick"]) * tick_ns)

    def time_of(where: Sequence[int]) -> list[int]:
        at = np.searchsorted(places, where, side="right") - 1
        return [int(time_ns) for time_ns in np.asarray(ticks_ns, dtype=np.int64)[at]]

    inputs = _inputs(recorded, receive_ids(unit, contract, "lockstep"))
    link = RestbusLink([frame for _, frame in inputs], time_of([where for where, _ in inputs]))
    node = build_node(unit, link, contract, clock="lockstep", tick_ns=tick_ns)
    _run(node, link, recorded, place, show, len(inputs))
    times = time_of([where for where, _ in recorded.own])
    said = [
        Said(time_ns, frame.can_id, frame.data)
        for time_ns, (_, frame) in zip(times, recorded.own, strict=True)
    ]
    return _Played(said, link.said, "SYNC", node.statistics.cycles, HALF_A_STEP)


def _real_time(
    unit: Unit, recorded: Recorded, contract: Contract, scenario: Scenario, place: Place, show: Show
) -> _Played:
    """Cycle by cycle, each at the time at which it woke in the recording."""
    del scenario
    stamps = np.array([frame.timestamp_ns for _, frame in recorded.own], dtype=np.int64)
    ended = next(
        (k for k, (where, _) in enumerate(recorded.own) if where == recorded.ended), len(recorded.own)
    )
    if not ended:
        raise ReplayError(f"{place.log}: {unit.name} has ended before its first cycle; nothing to compare")
    cycles = _cycles(unit, contract, [frame for _, frame in recorded.own[:ended]], place)
    inputs = _inputs(recorded, receive_ids(unit, contract, "realtime"))
    link = RestbusLink([frame for _, frame in inputs])
    # The unit's own timing is what this machine takes now, so it is not measured: the time stands still.
    node = Node(unit, link, RecordedClock(cycles, link), None, contract, monotonic=lambda: link.woke_ns)
    _run(node, link, recorded, place, show, len(inputs))
    start_ns = recorded.start_ns
    at = np.clip(cycles.cycle_of(stamps), 0, len(cycles) - 1)
    at[ended:] = len(cycles) - 1
    said = [
        Said(int(cycles.scheduled_ns[k]) - start_ns, frame.can_id, frame.data)
        for k, (_, frame) in zip(at, recorded.own, strict=True)
    ]
    replayed = [heard._replace(time_ns=heard.time_ns - start_ns) for heard in link.said]
    steps = REAL_TIME_STEPS if cycles.exact else STAMPS_ONLY_STEPS
    return _Played(said, replayed, cycles.source, node.statistics.cycles, steps)


def _cycles(unit: Unit, contract: Contract, own: Sequence[Frame], place: Place) -> Cycles:
    """The recorded cycles: from the recording beside the log if it has them, else from the node's frames."""
    if place.recording is not None:
        found = cycles_of_recording(place.recording, unit.name, unit.period_ns)
        if found is not None:
            return found
    always = every_cycle(unit)
    codecs = [codec for node in unit.nodes for codec in contract.sent_by(node)]
    speaks_always = any(
        codec.name in always or (codec.cycle_ns is not None and round(codec.cycle_ns / unit.period_ns) <= 1)
        for codec in codecs
    )
    return cycles_of_frames(
        np.array([frame.timestamp_ns for frame in own], dtype=np.int64),
        np.array([frame.can_id for frame in own], dtype=np.int64),
        unit.period_ns,
        every_cycle=speaks_always,
        repeats=frozenset(bus_identifier(codec) for codec in codecs if codec.cycle_ns is None),
    )


def _inputs(recorded: Recorded, receives: Sequence[int]) -> list[tuple[int, Frame]]:
    """What the node receives, until it ended."""
    wanted = frozenset(receives)
    return [
        (where, frame)
        for where, frame in recorded.others
        if frame.can_id in wanted and (recorded.ended is None or where < recorded.ended)
    ]


def _run(node: Node, link: RestbusLink, recorded: Recorded, place: Place, show: Show, frames: int) -> None:
    """All cycles of the recording, and the node's end if that is in it."""
    node.warm_up()
    should_stop = link.exhausted if recorded.lockstep else _never
    try:
        while node.cycle(should_stop):
            if node.statistics.cycles % CYCLES_BETWEEN_LOOKS == 0:
                show(link.received / max(frames, 1))
        if recorded.ended is not None:
            node.stop()
    except LockstepError as error:
        raise ReplayError(f"{place.log}: not a whole log of one run in lockstep: {error}") from None
    show(1.0)


def _never() -> bool:
    return False
