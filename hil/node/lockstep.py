"""Lockstep: time moves by SYNC, and a unit steps when those before it have answered."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.node.clock import CycleStart, never, realtime_offset_ns
from hil.node.inbox import bus_identifier

if TYPE_CHECKING:
    from hil.node.unit import FrameLink

__all__ = ["LockstepClock", "LockstepError"]

# How often a waiting clock looks whether it shall stop.
SLICE_S = 0.1


class LockstepError(RuntimeError):
    """The lockstep protocol broke: a peer is silent or ticks are missing."""

    exit_code = 3


class LockstepClock:
    """Time moves by SYNC: cycle k starts when SYNC(k) and SyncDone(k) of all `after` have been seen.

    What arrived before that point is the cycle's input. `finished()` acknowledges with the node's own
    SyncDone(k). A unit whose period is a multiple of the tick steps on its multiples only and acknowledges
    every tick. A peer that stays silent for `peer_timeout_s` is a `LockstepError`; time during which this
    process itself was stopped does not count.
    """

    kind = "lockstep"

    def __init__(
        self,
        transport: FrameLink,
        contract: Contract,
        node: str,
        after: Iterable[str],
        tick_ns: int,
        *,
        peer_timeout_s: float = 60.0,
        period_ns: int | None = None,
        monotonic: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        after = tuple(after)
        contract.require(["SYNC", f"{node}_SyncDone", *after])
        period_ns = tick_ns if period_ns is None else period_ns
        if tick_ns <= 0 or period_ns % tick_ns:
            raise ValueError(
                f"period {period_ns} ns must be a whole multiple of the lockstep tick, {tick_ns} ns"
            )
        self.tick_ns = tick_ns
        self.period_ns = period_ns
        self.peer_timeout_s = peer_timeout_s
        self.realtime_offset_ns = realtime_offset_ns(monotonic)
        self._transport = transport
        self._monotonic = monotonic
        self._sync = contract.message("SYNC")
        self._sync_id = bus_identifier(self._sync)
        self._done = contract.message(f"{node}_SyncDone")
        self._done_id = bus_identifier(self._done)
        self._after = {bus_identifier(contract.message(name)): contract.message(name) for name in after}
        self._after_ticks = dict.fromkeys(self._after, -1)
        self._tick = -1  # of the last SYNC
        self._acknowledged = -1
        self._frames: list[Frame] = []

    def wait(self, should_stop: Callable[[], bool] = never) -> CycleStart | None:
        """Collect frames until the next tick is complete; None when `should_stop` said so.

        A tick that is not a multiple of the unit's period is `idle`; its frames stay for the next step.
        """
        if not self._collect(should_stop):
            return None
        time_ns = self._tick * self.tick_ns
        return CycleStart(time_ns, self._monotonic(), 0, time_ns, idle=time_ns % self.period_ns != 0)

    def frames(self) -> list[Frame]:
        """Frames seen since the last cycle, stamped with the time of the tick in which they came."""
        frames, self._frames = self._frames, []
        return frames

    def closing(self) -> list[tuple[int, bytes | bytearray]]:
        """The node's SyncDone: sent together with the outputs, it costs no wake-up of its own."""
        self._acknowledged = self._tick
        return [(self._done_id, self._done.encode({"Tick": self._tick}))]

    def finished(self, ended_ns: int) -> int:
        """Acknowledge the tick if `closing` has not. There are no deadlines in lockstep: always 0."""
        del ended_ns
        if self._acknowledged != self._tick:
            self._acknowledge()
        return 0

    def _acknowledge(self) -> None:
        self._transport.send_all(self.closing())

    def _collect(self, should_stop: Callable[[], bool]) -> bool:
        """Take frames up to the one that completes the next tick; later ones stay for the tick after."""
        receive, monotonic = self._transport.receive, self._monotonic
        waited_s = 0.0
        last = monotonic()
        while not should_stop():
            frame = receive(SLICE_S)  # reads ahead: what came together costs one system call
            if frame is not None and self._completes_tick(frame):
                return True
            # Capped per look, so that a process stopped for minutes does not blame its peers.
            now = monotonic()
            waited_s += SLICE_S if frame is None else min((now - last) * 1e-9, SLICE_S)
            last = now
            if frame is None and waited_s >= self.peer_timeout_s:
                raise LockstepError(self._awaited())
        return False

    def _completes_tick(self, frame: Frame) -> bool:
        can_id = frame.can_id
        if can_id == self._sync_id:
            tick = int(self._sync.decode(frame.data)["Tick"])
            if tick == self._tick:
                return False
            if self._tick >= 0 and tick != self._tick + 1:
                raise LockstepError(
                    f"SYNC({tick}) followed SYNC({self._tick}): ticks were lost, or two benches share "
                    "the bus; give each run a channel of its own"
                )
            self._tick = tick
        elif can_id in self._after:
            self._after_ticks[can_id] = int(self._after[can_id].decode(frame.data)["Tick"])
            self._infer_sync()
        else:
            self._frames.append(Frame(max(self._tick, 0) * self.tick_ns, can_id, frame.data))
            return False
        return self._tick > self._acknowledged and all(t == self._tick for t in self._after_ticks.values())

    def _infer_sync(self) -> None:
        """Nobody answers a tick that has not begun: the answers say what SYNC would.

        So a unit that waits for others need not listen to SYNC, and is woken once a tick, not twice.
        """
        tick = self._tick + 1
        if all(answered == tick for answered in self._after_ticks.values()):
            self._tick = tick
            now = tick * self.tick_ns
            self._frames = [Frame(now, can_id, data) for _, can_id, data in self._frames]

    def _awaited(self) -> str:
        limit = f"within {self.peer_timeout_s:g} s"
        if self._tick <= self._acknowledged:
            wanted = "the first SYNC" if self._tick < 0 else f"SYNC({self._tick + 1})"
            return f"{wanted} did not come {limit}: the bench that sends it is not running or not on this bus"
        missing = [self._after[i].name for i, tick in self._after_ticks.items() if tick != self._tick]
        awaited = " and ".join(f"{name}({self._tick})" for name in missing)
        return f"{awaited} did not come {limit} after SYNC({self._tick}): the sender has died or hangs"
