"""One node alone with a recorded bus: what the others said comes from the log, what it says is kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from hil.bench.replay.cycles import Cycles
from hil.canbus.frame import Frame
from hil.node.clock import CycleStart, never

__all__ = ["RecordedClock", "RestbusLink", "Said"]


class Said(NamedTuple):
    """A frame that the node sent: simulated or scheduled time of its cycle [ns], identifier, data."""

    time_ns: int
    can_id: int
    data: bytes


class RestbusLink:
    """The node's place on the recorded bus: a `FrameLink`. `now_ns` is the time of the running cycle,
    `woke_ns` when it woke (real time).

    With `times_ns`, one for each frame, it moves on by itself with the frames received (lockstep).
    """

    def __init__(self, frames: Sequence[Frame], times_ns: Sequence[int] | None = None) -> None:
        self.sent = 0
        self.received = 0
        self.dropped = 0
        self.now_ns = self.woke_ns = 0
        self.said: list[Said] = []
        self._frames = frames
        self._times_ns = times_ns

    def exhausted(self) -> bool:
        """Whether every recorded frame has been received."""
        return self.received >= len(self._frames)

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """Keep a frame that the node sends."""
        self.sent += 1
        self.said.append(Said(self.now_ns, can_id, bytes(data)))

    def send_all(self, frames: Sequence[tuple[int, bytes | bytearray]]) -> None:
        """Keep frames in this order."""
        for can_id, data in frames:
            self.send(can_id, data)

    def drain(self) -> list[Frame]:
        """All that is left."""
        return self.take_until(None)

    def take_until(self, stamp_ns: int | None) -> list[Frame]:
        """The frames up to this stamp that have not been received; None: all."""
        begin = at = self.received
        frames = self._frames
        while at < len(frames) and (stamp_ns is None or frames[at].timestamp_ns <= stamp_ns):
            at += 1
        self.received = at
        return list(frames[begin:at])

    def receive(self, timeout_s: float | None) -> Frame | None:
        """The next frame; None after the last."""
        if self.exhausted():
            return None
        at = self.received
        self.received += 1
        if self._times_ns is not None:
            self.now_ns = self._times_ns[at]
        return self._frames[at]


class RecordedClock:
    """The cycles of a real-time recording once more, as fast as they go: a `Clock`.

    All times are epoch ns, those of the frames too; a unit only ever looks at differences.
    """

    kind = "realtime"
    realtime_offset_ns = 0

    def __init__(self, cycles: Cycles, link: RestbusLink) -> None:
        self._link = link
        columns = (cycles.scheduled_ns, cycles.woke_ns, cycles.drained_ns, cycles.skipped)
        self._rows = list(zip(*(column.tolist() for column in columns), strict=True))
        self._next = 0

    def wait(self, should_stop: Callable[[], bool] = never) -> CycleStart | None:
        """The next recorded cycle; None after the last."""
        if self._next >= len(self._rows) or should_stop():
            return None
        scheduled_ns, woke_ns, _, skipped = self._rows[self._next]
        self._next += 1
        self._link.now_ns, self._link.woke_ns = scheduled_ns, woke_ns
        return CycleStart(scheduled_ns, woke_ns, skipped, woke_ns)

    def frames(self) -> list[Frame]:
        """What had arrived when the recorded cycle read the bus."""
        return self._link.take_until(self._rows[self._next - 1][2])

    def closing(self) -> list[tuple[int, bytes | bytearray]]:
        """Nothing."""
        return []

    def finished(self, ended_ns: int) -> int:
        """How many deadlines the recorded node missed here: the cycles that it skipped next."""
        del ended_ns
        return self._rows[self._next][3] if self._next < len(self._rows) else 0
