"""A run without recording: both nodes in this thread, as fast as they go, their probes kept in memory.

Same nodes, same bus, same turns as `hil run --lockstep -i virtual`, so the same frames byte for byte; and
judged by the same functions, since what is kept answers `probe` as a recorded run does.
"""

from __future__ import annotations

import tempfile
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.bench.loss import frame_loss
from hil.bench.metrics import Array, ControlMetrics, control_metrics
from hil.bench.outcome import Interrupted
from hil.bench.scenario import Scenario, load_scenario
from hil.bench.summary import recorded_interventions, recorded_tracking, recorded_truth
from hil.bench.sync import LAST_IN_CHAIN, BenchNode
from hil.bench.turns import NODES, garbage_collection_frozen, take_turns
from hil.bench.watch import Ending, View, Watch
from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.canbus.memory import MemoryChannel
from hil.node import Inbox, Outbox, Unit
from hil.node.inbox import bus_identifier
from hil.node.process import build_node, receive_ids

NS_PER_S = 1e9
US_PER_NS = 1e-3


@dataclass(frozen=True)
class BareRun:
    """What is left of a run: how it ended and every probe of every cycle, in memory."""

    scenario: Scenario
    ending: Ending
    simulated_s: float
    wall_s: float
    lost_on_purpose: int
    step_us: Mapping[str, Array]
    """Time that a unit's step took in each cycle, by process."""
    _columns: Mapping[str, Mapping[str, Array]]

    def probe(self, process: str, name: str) -> tuple[Array, Array]:
        """Time since the start [s] and value of a probe in each cycle, both (n); KeyError: no such probe."""
        columns = self._columns[process]
        return columns["time_s"], columns[name]

    def probes(self, process: str) -> tuple[str, ...]:
        """Names of a process's probes."""
        return tuple(name for name in self._columns[process] if name != "time_s")

    def metrics(self, contract: Contract) -> ControlMetrics:
        """Quality of control, as `hil run` judges it."""
        return control_metrics(
            recorded_truth(self),
            recorded_tracking(self, contract),
            stop_position_m=self.scenario.journey.destination.position_m,
        )

    def interventions(self, contract: Contract) -> int:
        """How often the supervision took over."""
        return recorded_interventions(self, contract) or 0


def bare_run(
    name_or_path: str,
    overrides: Sequence[str],
    contract: Contract,
    *,
    interrupted: Interrupted = lambda: 0,
    tap: Callable[[Sequence[Frame]], None] | None = None,
) -> BareRun:
    """Drive a scenario with these overrides (`dotted.key=value`) to its end; `tap` hears every frame.

    Raises the errors of a scenario or a plan that is wrong. A node that dies in mid-run is in the ending.
    """
    with tempfile.TemporaryDirectory(prefix="hil-") as scratch:
        scenario = load_scenario(name_or_path, overrides, scratch=Path(scratch))
        units = {name: _Kept(build) for name, build in _built(Path(scratch) / "scenario.toml", contract)}
        return _drive(scenario, units, contract, interrupted, tap)


def _built(scenario: Path, contract: Contract) -> list[tuple[str, Unit]]:
    builders = {entry.name: entry.load() for entry in entry_points(group="hil.node.unit")}
    return [(name, builders[name](scenario, contract)) for name in NODES]


def _drive(
    scenario: Scenario,
    units: Mapping[str, _Kept],
    contract: Contract,
    interrupted: Interrupted,
    tap: Callable[[Sequence[Frame]], None] | None,
) -> BareRun:
    tick_s = min(scenario.controller_period_s, scenario.plant_period_s)
    watch = Watch(contract, time_limit_s=2.0 * scenario.journey.time_s + 60.0)
    channel = MemoryChannel(frame_loss(contract, scenario.bus.loss_probability, scenario.journey.seed))
    last = bus_identifier(contract.message(LAST_IN_CHAIN))
    bench = BenchNode(channel.link([*watch.identifiers, last]), contract, watch, tick_s=tick_s)
    listener = channel.link() if tap is not None else None
    nodes = {
        name: build_node(
            unit,
            channel.link(receive_ids(unit, contract, "lockstep")),
            contract,
            clock="lockstep",
            tick_ns=round(tick_s * NS_PER_S),
        )
        for name, unit in units.items()
    }
    for node in nodes.values():
        node.warm_up()
    for unit in units.values():
        unit.forget()

    def listen() -> None:
        if tap is not None and listener is not None:
            tap(listener.drain())

    with garbage_collection_frozen():
        start = time.monotonic()
        ending, simulated_s = take_turns(
            bench, nodes, watch,
            tick_s=tick_s, show=_silent, interrupted=interrupted, each_block=listen,
        )  # fmt: skip
        for name, node in nodes.items():
            if name != "controller" or not bench.controller_is_gone:
                node.stop()
        listen()
        wall_s = time.monotonic() - start
    return BareRun(
        scenario=scenario,
        ending=ending,
        simulated_s=simulated_s,
        wall_s=wall_s,
        lost_on_purpose=channel.lost,
        step_us={name: unit.step_us() for name, unit in units.items()},
        _columns={name: unit.columns() for name, unit in units.items()},
    )


def _silent(view: View, speedup: float | None) -> None:
    pass


class _Kept:
    """A unit whose probes, and the time that its step takes, are kept after every step."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._step, self.probe = unit.step, unit.probe
        self._rows = array("d")
        self._clock = time.perf_counter_ns

    def __getattr__(self, name: str) -> Any:
        return getattr(self._unit, name)

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        begin = self._clock()
        self._step(now_ns, inbox, outbox)
        self._rows.extend((now_ns, self._clock() - begin, *self.probe()))

    def forget(self) -> None:
        """Warming up is no part of the run."""
        self._rows = array("d")

    def columns(self) -> dict[str, Array]:
        names = [probe.name for probe in self._unit.probes]
        rows = self._table()
        columns = {"time_s": rows[:, 0] / NS_PER_S}
        return columns | {name: rows[:, 2 + k].copy() for k, name in enumerate(names)}

    def step_us(self) -> Array:
        steps: Array = self._table()[:, 1] * US_PER_NS
        return steps

    def _table(self) -> NDArray[np.float64]:
        return np.frombuffer(self._rows, np.float64).reshape(-1, 2 + len(self._unit.probes))
