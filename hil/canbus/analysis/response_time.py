"""Worst-case response times of messages on CAN: a pure function of the message set.

R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien, "Controller Area Network (CAN) schedulability analysis:
Refuted, revisited and revised", Real-Time Systems 35 (2007), section 3.2: all instances of a message within
its busy period are looked at, because the longest response need not be the first one's. Holds when each
node hands its most urgent frame to arbitration, for deadlines up to any length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

ERROR_BITS = 31
"""Longest error signalling: two error flags (6 + 6), delimiter (8), interframe space (3), suspend (8)."""

BUSY_PERIOD_LIMIT_NS = 60_000_000_000
"""A busy period that is longer is taken as having no end: the bus is full for practical purposes."""


@dataclass(frozen=True)
class Stream:
    """The instances of one message, as the analysis sees them; all times in ns.

    `transmission_ns` is the longest frame with its interframe space; `period_ns` the shortest time between
    two initiating events; `jitter_ns` the longest time from the event until the frame is queued.
    """

    name: str
    transmission_ns: int
    period_ns: int
    deadline_ns: int
    jitter_ns: int = 0


@dataclass(frozen=True)
class FaultHypothesis:
    """Disturbances of the bus: `burst` errors at once, then one more every `interval_ns` at most.

    K. Tindell, A. Burns, "Guaranteed message latencies for distributed safety-critical hard real-time
    control networks", report YCS 229, University of York (1994).
    """

    interval_ns: int
    burst: int = 1

    def errors(self, window_ns: int) -> int:
        """The most errors in a window [ns]."""
        return self.burst - 1 + -(-window_ns // self.interval_ns)


@dataclass(frozen=True)
class Bound:
    """The response-time bound of one stream.

    `response_ns` counts from the initiating event to the end of the frame; None: there is no bound, since
    the message and those more urgent ask for all of the bus or more. `instance` is the frame within the
    busy period that has this response, `instances` how many there are. `buffering_ns`: the longest wait
    behind other frames of its own first-in first-out queue; None: no bound.
    """

    stream: Stream
    blocking_ns: int
    busy_period_ns: int | None
    response_ns: int | None
    instance: int
    instances: int
    buffering_ns: int | None = 0

    @property
    def slack_ns(self) -> int | None:
        """Deadline minus bound; negative when the deadline can be missed."""
        return None if self.response_ns is None else self.stream.deadline_ns - self.response_ns

    @property
    def meets(self) -> bool:
        """Whether no instance can ever miss its deadline."""
        return self.response_ns is not None and self.response_ns <= self.stream.deadline_ns


def bounds(streams: Sequence[Stream], bit_ns: int, faults: FaultHypothesis | None = None) -> list[Bound]:
    """The bound of each stream; `streams` most urgent first, `bit_ns` the nominal bit time (rounded up).

    ValueError: a time that cannot be (period or transmission not positive, jitter negative).
    """
    check_streams(streams)
    return [_bound(streams, place, bit_ns, faults) for place in range(len(streams))]


def check_streams(streams: Sequence[Stream]) -> None:
    """ValueError: a time that cannot be (period or transmission not positive, jitter negative)."""
    for stream in streams:
        if stream.period_ns <= 0 or stream.transmission_ns <= 0 or stream.jitter_ns < 0:
            raise ValueError(f"{stream.name}: period and transmission must be positive, jitter not negative")


def schedulable(streams: Sequence[Stream], bit_ns: int, faults: FaultHypothesis | None = None) -> bool:
    """Whether every stream meets its deadline; stops at the first that does not."""
    return all(_bound(streams, place, bit_ns, faults).meets for place in range(len(streams)))


def _bound(streams: Sequence[Stream], place: int, bit_ns: int, faults: FaultHypothesis | None) -> Bound:
    own, urgent = streams[place], streams[:place]
    blocking = max((other.transmission_ns for other in streams[place + 1 :]), default=0)
    repeat_ns = ERROR_BITS * bit_ns + max(stream.transmission_ns for stream in (*urgent, own))

    def error_time(window_ns: int) -> int:
        return 0 if faults is None else faults.errors(window_ns) * repeat_ns

    demand = sum(stream.transmission_ns / stream.period_ns for stream in (*urgent, own))
    if faults is not None:
        demand += repeat_ns / faults.interval_ns
    busy = _busy_period((*urgent, own), blocking, error_time) if demand < 1.0 else None
    if busy is None:
        return Bound(own, blocking, None, None, 0, 0)
    instances = -(-(busy + own.jitter_ns) // own.period_ns)
    worst, instance, wait = -1, 0, blocking
    for number in range(instances):
        wait = _queueing(own, urgent, number, wait, blocking, bit_ns, error_time)
        response = own.jitter_ns + wait - number * own.period_ns + own.transmission_ns
        if response > worst:
            worst, instance = response, number
        wait += own.transmission_ns  # the next instance waits for this one
    return Bound(own, blocking, busy, worst, instance, instances)


def _busy_period(streams: Sequence[Stream], blocking: int, error_time: Callable[[int], int]) -> int | None:
    """Longest time that the bus is busy with these streams, the last of them starting it; None: no end."""
    busy = streams[-1].transmission_ns
    while busy <= BUSY_PERIOD_LIMIT_NS:
        longer = blocking + error_time(busy)
        for other in streams:
            longer += -(-(busy + other.jitter_ns) // other.period_ns) * other.transmission_ns
        if longer == busy:
            return busy
        busy = longer
    return None


def _queueing(
    own: Stream,
    urgent: Sequence[Stream],
    number: int,
    start: int,
    blocking: int,
    bit_ns: int,
    error_time: Callable[[int], int],
) -> int:
    """From the start of the busy period until instance `number` wins arbitration, at the latest."""
    wait = start
    while True:
        longer = blocking + number * own.transmission_ns + error_time(wait + own.transmission_ns)
        for other in urgent:
            # One bit more: who is queued before this frame's first bit is over still takes part.
            longer += -(-(wait + other.jitter_ns + bit_ns) // other.period_ns) * other.transmission_ns
        if longer == wait:
            return wait
        wait = longer
