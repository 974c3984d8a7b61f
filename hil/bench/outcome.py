"""What a run was asked to do, and how it went: shared by every way of running."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.bench.scenario import Scenario
from hil.bench.watch import Ending, View
from hil.canbus.transport import BusOptions

Show = Callable[[View, float | None], None]
"""Called with the train as last heard, and the speed-up over real time (None in real time)."""

Interrupted = Callable[[], int]
"""How many times the user has asked to stop (Ctrl-C)."""


@dataclass(frozen=True)
class RunOptions:
    """One run: which scenario, on which bus, under which clock, and where its results go."""

    scenario: Scenario
    out: Path
    bus: BusOptions
    channel_is_given: bool = False  # False: a free local channel may be chosen
    lockstep: bool = False
    view: bool = False  # open the viewer's window
    viewer_url: str | None = None  # a Rerun server that listens already, to send to live
    priority: int | None = 50  # SCHED_FIFO priority of the controller; None: do not ask
    dbc: Path | None = None
    logs: tuple[str, ...] = ()  # formats of the frame log beside BLF

    @property
    def mode(self) -> str:
        """`real-time` or `lockstep`."""
        return "lockstep" if self.lockstep else "real-time"

    @property
    def tick_s(self) -> float:
        """Lockstep tick: the shorter of the two nodes' periods [s]."""
        return min(self.scenario.controller_period_s, self.scenario.plant_period_s)

    @property
    def time_limit_s(self) -> float:
        """When a run that has not arrived is given up [s]."""
        return 2.0 * self.scenario.journey.time_s + 60.0

    @property
    def tick_ns(self) -> int:
        """Lockstep tick [ns]."""
        return round(self.tick_s * 1e9)


@dataclass
class Outcome:
    """How a run went, before its recording is judged."""

    ending: Ending
    bus: BusOptions
    started: str  # ISO 8601, UTC
    wall_time_s: float
    simulated_time_s: float
    one_process: bool
    nodes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Status of each node when it ended; empty for one that did not end well."""
    recorder: Mapping[str, Any] = field(default_factory=dict)
    """Likewise of the recorder."""
    bench_dropped: int = 0
    bench_sent: int = 0
    wire: Mapping[str, Any] = field(default_factory=dict)
    """The wire of a local bus with a bit rate while the train drove: `hil.bench.wire.traffic_between`."""
    lost_on_purpose: int = 0
    """Frames that the bench itself took away (`[bus] loss_probability`)."""

    @property
    def speedup(self) -> float:
        """Simulated over wall-clock time of the loop itself."""
        return self.simulated_time_s / self.wall_time_s if self.wall_time_s > 0 else 0.0
