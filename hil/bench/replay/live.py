"""The restbus in real time: recorded frames sent on a bus when they are due, and what a device answers.

The device is whatever sends the messages of the node under test: our own node as a process, another build of
it, or a box on a CAN interface. Its cycles cannot be asked for, only seen on the bus; so the time of the
recording is laid such that the first frame of its fastest cyclic message comes when it came in the recording.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from hil.bench.replay.restbus import Said
from hil.canbus.frame import Frame

__all__ = ["Due", "Live", "LiveLink", "Silent", "TimeBase", "play_live"]

NS_PER_S = 1e9
LONGEST_WAIT_S = 0.05
"""So often at least the caller is asked whether to stop, and told how far it is."""

SLEEP_BEFORE_NS = 1_500_000
"""The last part of a wait is slept, not spent in the bus's receive, which may count in milliseconds."""

OLDEST_NS = 1_000_000_000
"""A frame cannot have waited longer in a buffer that is read all the time: its stamp is of another clock."""


class LiveLink(Protocol):
    """What the restbus needs of a bus (a `Transport` has it); stamps are epoch ns."""

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """Send a data frame."""

    def receive(self, timeout_s: float | None) -> Frame | None:
        """The next frame; None after that time."""

    def drain(self) -> list[Frame]:
        """All frames that wait."""


class Due(NamedTuple):
    """A frame of the restbus and when it is due [ns] after the device's first cycle."""

    due_ns: int
    can_id: int
    data: bytes


@dataclass(frozen=True)
class TimeBase:
    """The clocks of a live replay. `now_ns`: monotonic, `epoch_ns`: that of the stamps."""

    now_ns: Callable[[], int] = time.monotonic_ns
    epoch_ns: Callable[[], int] = time.time_ns
    sleep_s: Callable[[float], None] = time.sleep


class Silent(RuntimeError):
    """The device has not said anything, so that there is nothing to play to."""


@dataclass
class Live:
    """How it went. `said`: frames of the device, ns after its first cycle; `late_ns`: how late each frame of
    the restbus was given to the bus; `played_ns`: up to when the recording was played.
    """

    said: list[Said] = field(default_factory=list)
    late_ns: list[int] = field(default_factory=list)
    played_ns: int = 0
    stopped: bool = False


def play_live(
    link: LiveLink,
    restbus: Sequence[Due],
    *,
    anchors: Iterable[int],
    until_ns: int,
    wait_s: float,
    should_stop: Callable[[], bool],
    show: Callable[[float], None] = lambda share: None,
    base: TimeBase | None = None,
) -> Live:
    """Wait for the device's first frame with an identifier of `anchors`, then play up to `until_ns`.

    Frames due before the device's first cycle (negative `due_ns`) go out with it, in their order: they were
    waiting for it in the recording. `should_stop` is asked at least every 50 ms and may raise; what was heard
    until it says yes is kept. Raises Silent after `wait_s` without such a frame, and the errors of the bus.
    """
    base = base or TimeBase()
    live = Live()
    before, zero = _first_cycle(link, frozenset(anchors), wait_s, should_stop, base)
    if zero is None:
        live.stopped = True
        return live
    zero_epoch_ns = before[-1].timestamp_ns
    heard = _Heard(live, zero_epoch_ns)
    heard.keep(before)
    started_ns = base.now_ns()
    for frame in restbus:
        if frame.due_ns > until_ns:
            break
        if not _wait_until(zero + frame.due_ns, link, heard, should_stop, base):
            live.stopped = True
            break
        # One that was due before the device's first cycle is not late: it could not go out sooner.
        live.late_ns.append(base.now_ns() - max(zero + frame.due_ns, started_ns))
        link.send(frame.can_id, frame.data)
        live.played_ns = max(frame.due_ns, 0)
        if len(live.late_ns) % 64 == 0:
            heard.keep(link.drain())
            show(live.played_ns / max(until_ns, 1))
    if not live.stopped:
        live.stopped = not _wait_until(zero + until_ns, link, heard, should_stop, base)
    if not live.stopped:
        live.played_ns = until_ns
    heard.keep(link.drain())
    show(1.0)
    return live


class _Heard:
    """Keeps frames of the device with times that count from its first cycle."""

    def __init__(self, live: Live, zero_epoch_ns: int) -> None:
        self._live = live
        self._zero_epoch_ns = zero_epoch_ns

    def keep(self, frames: Iterable[Frame]) -> None:
        self._live.said.extend(
            Said(frame.timestamp_ns - self._zero_epoch_ns, frame.can_id, bytes(frame.data))
            for frame in frames
        )


def _first_cycle(
    link: LiveLink, anchors: frozenset[int], wait_s: float, should_stop: Callable[[], bool], base: TimeBase
) -> tuple[list[Frame], int | None]:
    """All frames up to the first anchor, and when that came, monotonic ns; None: told to stop."""
    frames: list[Frame] = []
    deadline_ns = base.now_ns() + round(wait_s * NS_PER_S)
    while True:
        if should_stop():
            return frames, None
        left_s = (deadline_ns - base.now_ns()) / NS_PER_S
        if left_s <= 0:
            raise Silent
        frame = link.receive(min(left_s, LONGEST_WAIT_S))
        if frame is None:
            continue
        frames.append(frame)
        if frame.can_id in anchors:
            age_ns = base.epoch_ns() - frame.timestamp_ns
            return frames, base.now_ns() - (age_ns if 0 <= age_ns <= OLDEST_NS else 0)


def _wait_until(
    at_ns: int, link: LiveLink, heard: _Heard, should_stop: Callable[[], bool], base: TimeBase
) -> bool:
    """Listen until then; False: told to stop."""
    while True:
        if should_stop():
            return False
        left_ns = at_ns - base.now_ns()
        if left_ns <= 0:
            return True
        if left_ns > SLEEP_BEFORE_NS:
            frame = link.receive(min((left_ns - SLEEP_BEFORE_NS) / NS_PER_S, LONGEST_WAIT_S))
            if frame is not None:
                heard.keep([frame])
        else:
            heard.keep(link.drain())
            left_ns = at_ns - base.now_ns()
            if left_ns > 0:
                base.sleep_s(left_ns / NS_PER_S)
