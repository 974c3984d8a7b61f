"""When and where things happened: what every frame and every cycle is placed by.

`bus_time` is absolute (epoch ns), `sim_time` counts from the start of the recording, `cycle` is the
controller's cycle, `position` the train's odometer in mm. In real time a frame has the interface's
time stamp and a cycle its monotonic time, moved by the offset in its ring's header. In lockstep time is
start + tick * period, the tick being that of the last SYNC in the stream.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hil.canbus.contract import Contract, ContractError
from hil.node import RingHeader
from hil.record.blocks import Block

__all__ = ["ForwardFill", "Instants", "LockstepTime", "RealTime", "RecordingTime", "Signal", "find_signal"]

SYNC_MESSAGE, SYNC_SIGNAL = "SYNC", "Tick"  # CANopen SYNC (CiA 301) with the tick that the bench adds

Times = NDArray[np.int64]


@dataclass(frozen=True)
class Instants:
    """n places on all timelines: `bus_ns` and `start_ns` in epoch ns, `position_mm`."""

    start_ns: int
    bus_ns: Times
    cycle: Times
    position_mm: Times

    def __len__(self) -> int:
        return len(self.bus_ns)

    def take(self, rows: NDArray[np.intp]) -> Instants:
        """The places of some rows."""
        return Instants(self.start_ns, self.bus_ns[rows], self.cycle[rows], self.position_mm[rows])

    def from_start(self) -> Instants:
        """The same, the first one moved to the start of the recording, where a drawing begins."""
        bus_ns = self.bus_ns.copy()
        bus_ns[:1] = self.start_ns
        return Instants(self.start_ns, bus_ns, self.cycle, self.position_mm)

    @property
    def since_start_ns(self) -> Times:
        """Time since the start of the recording, ns."""
        return self.bus_ns - self.start_ns


class RecordingTime(Protocol):
    """How a run's time is told: from time stamps, or from SYNC."""

    start_ns: int | None  # epoch ns at which the run starts; None: when the first thing happens

    def of_frames(self, block: Block) -> Times:
        """Epoch ns of each frame."""

    def of_cycles(self, scheduled_ns: Times, header: RingHeader) -> Times:
        """Epoch ns at which each cycle of a ring was scheduled."""

    def cycles(self, times_ns: Times) -> Times | None:
        """The cycle at each time, if time alone tells; else None."""


class RealTime:
    """Frames carry epoch time, rings monotonic time with the offset between both."""

    start_ns: int | None = None

    def of_frames(self, block: Block) -> Times:
        """Epoch ns of each frame."""
        return block.stamps_ns

    def of_cycles(self, scheduled_ns: Times, header: RingHeader) -> Times:
        """Epoch ns at which each cycle of a ring was scheduled."""
        return scheduled_ns + header.realtime_offset_ns

    def cycles(self, times_ns: Times) -> Times | None:
        """Time does not tell: cycles may have been skipped."""
        return None


class LockstepTime:
    """Frames from SYNC(k) on, up to the next, belong to tick k; those before the first SYNC to tick 0."""

    def __init__(self, contract: Contract, start_ns: int, tick_ns: int) -> None:
        if tick_ns <= 0:
            raise ContractError(f"the lockstep tick must be longer than 0, not {tick_ns} ns")
        contract.message(SYNC_MESSAGE).signal(SYNC_SIGNAL)
        self.start_ns: int | None = start_ns
        self._origin_ns = start_ns
        self.tick_ns = tick_ns
        self._tick = 0

    def of_frames(self, block: Block) -> Times:
        """Epoch ns of each frame."""
        ticks = np.full(len(block), self._tick, np.int64)
        sync = block.messages.get(SYNC_MESSAGE)
        if sync is not None:
            known = sync.column(SYNC_SIGNAL).astype(np.int64)
            latest = np.searchsorted(sync.rows, np.arange(len(block)), side="right") - 1
            ticks = np.where(latest >= 0, known[np.maximum(latest, 0)], self._tick)
            self._tick = int(known[-1])
        times: Times = self._origin_ns + ticks * self.tick_ns
        return times

    def of_cycles(self, scheduled_ns: Times, header: RingHeader) -> Times:
        """Epoch ns at which each cycle of a ring was scheduled."""
        return scheduled_ns + self._origin_ns

    def cycles(self, times_ns: Times) -> Times | None:
        """The tick at each time."""
        return (times_ns - self._origin_ns) // self.tick_ns


class ForwardFill:
    """A quantity known at some times, read at others: the latest value known then, memory bounded."""

    def __init__(self, initial: int = 0, *, keep: int = 16384) -> None:
        self._before = initial
        self._keep = keep
        self._times = np.empty(0, np.int64)
        self._values = np.empty(0, np.int64)

    def add(self, times: Times, values: Times) -> None:
        """Learn values at these times, in the order of time."""
        if not len(times):
            return
        if not len(self._times):
            self._before = int(values[0])
        self._times = np.maximum.accumulate(np.concatenate((self._times, times)))[-self._keep :]
        self._values = np.concatenate((self._values, values))[-self._keep :]

    def at(self, times: Times) -> Times:
        """The value at each time; before the first known one that one."""
        if not len(self._times):
            return np.full(len(times), self._before, np.int64)
        latest = np.searchsorted(self._times, times, side="right") - 1
        return self._values[np.maximum(latest, 0)]


@dataclass(frozen=True)
class Signal:
    """A signal of the contract by name, as `Message.Signal`, with its factor to SI."""

    message: str
    name: str
    unit: str
    si_factor: float


def find_signal(name: str, contract: Contract) -> Signal:
    """Read `Message.Signal`. Raises ContractError that lists what there is."""
    message, _, signal = name.partition(".")
    spec = contract.message(message).signal(signal)
    return Signal(message, signal, spec.unit, spec.si_factor)
