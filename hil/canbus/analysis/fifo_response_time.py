"""Worst-case response times where nodes send through first-in first-out queues: a pure function.

After R. I. Davis, S. Kollmann, V. Pollex, F. Slomka, "Schedulability analysis for Controller Area Network
(CAN) with FIFO queues, priority queues and gateways", Real-Time Systems 49 (2013): all frames of a queue are
as late as if each had the lowest priority in it, and a frame that waits in its own queue behind a less urgent
one interferes with other nodes later than it was queued, by its buffering time, which counts as jitter.
Deadlines may be longer than periods, as in R. I. Davis, N. Navet, "Controller Area Network (CAN)
schedulability analysis for messages with arbitrary deadlines in FIFO and work-conserving queues", WFCS 2012:
all frames queued within a busy period are looked at.

One thing is tighter than there: the buffering time counts only against queues whose level (their lowest
priority) lies above that of the interfering queue. The first frame of a queue of a more urgent level always
wins against the level, so none of its frames can be waiting when a busy period of that level starts. Hence
each level needs the buffering times of less urgent levels only, and no iteration over all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence

from hil.canbus.analysis.response_time import (
    BUSY_PERIOD_LIMIT_NS,
    ERROR_BITS,
    Bound,
    FaultHypothesis,
    Stream,
    check_streams,
)


def fifo_bounds(
    streams: Sequence[Stream],
    queues: Sequence[Hashable | None],
    bit_ns: int,
    faults: FaultHypothesis | None = None,
) -> list[Bound]:
    """The bound of each stream, most urgent first; `queues`: the queue of each, None: a mailbox of its own.

    With mailboxes only, these are `bounds`. ValueError: a time that cannot be.
    """
    check_streams(streams)
    if len(queues) != len(streams):
        raise ValueError(f"{len(queues)} queues for {len(streams)} streams")
    groups: dict[Hashable, list[int]] = {}
    for place, queue in enumerate(queues):
        groups.setdefault(("mailbox", place) if queue is None else ("queue", queue), []).append(place)
    found: dict[int, Bound] = {}
    level_of = {place: places[-1] for places in groups.values() for place in places}
    # The least urgent level first: more urgent ones need its buffering times.
    for places in sorted(groups.values(), key=lambda places: -places[-1]):
        level = _Level(streams, places, level_of, found, bit_ns, faults)
        found.update({place: level.bound(place) for place in places})
    return [found[place] for place in range(len(streams))]


class _Level:
    """One queue, and all that is more urgent than its least urgent stream."""

    def __init__(
        self,
        streams: Sequence[Stream],
        places: Sequence[int],
        level_of: dict[int, int],
        known: dict[int, Bound],
        bit_ns: int,
        faults: FaultHypothesis | None,
    ) -> None:
        lowest = places[-1]
        self._streams = streams
        self._own = [streams[place] for place in places]
        self._bit_ns = bit_ns
        self._blocking = max((other.transmission_ns for other in streams[lowest + 1 :]), default=0)
        self._urgent: list[tuple[Stream, int]] = []  # with jitter and buffering time [ns]
        self._endless = False
        for place in sorted(set(range(lowest)) - set(places)):
            buffering = known[place].buffering_ns if level_of[place] > lowest else 0
            self._endless |= buffering is None
            self._urgent.append((streams[place], streams[place].jitter_ns + (buffering or 0)))
        all_streams = [*self._own, *(stream for stream, _ in self._urgent)]
        repeat_ns = ERROR_BITS * bit_ns + max(stream.transmission_ns for stream in all_streams)
        self._errors: Callable[[int], int] = (
            (lambda window: 0) if faults is None else (lambda window: faults.errors(window) * repeat_ns)
        )
        demand = sum(stream.transmission_ns / stream.period_ns for stream in all_streams)
        if faults is not None:
            demand += repeat_ns / faults.interval_ns
        self._busy = None if self._endless or demand >= 1.0 else self._busy_period()

    def bound(self, place: int) -> Bound:
        """Response bound and buffering time of one stream of the queue."""
        own, busy = self._streams[place], self._busy
        if busy is None:
            alone = len(self._own) == 1
            return Bound(own, self._blocking, None, None, 0, 0, 0 if alone else None)
        worst, instance, wait = -1, 0, 0
        # Event at `queued - jitter`: as late in its queue as it can be.
        for queued in self._times(own, busy, own_jitter_ns=0):
            number = queued // own.period_ns
            ahead = self._queued(queued, own) + number * own.transmission_ns
            wait = self._wait(wait, ahead, own.transmission_ns)
            response = own.jitter_ns + wait + own.transmission_ns - queued
            if response > worst:
                worst, instance = response, number
        instances = -(-(busy + own.jitter_ns) // own.period_ns)
        return Bound(own, self._blocking, busy, worst, instance, instances, self._buffering(own, busy))

    def _buffering(self, own: Stream, busy: int) -> int:
        """The longest time from queued until it is the first of its queue."""
        if len(self._own) == 1:
            return 0  # behind itself: then the level is busy anyhow
        shortest = min(stream.transmission_ns for stream in self._own)
        longest, wait = 0, 0
        for queued in self._times(own, busy, own_jitter_ns=own.jitter_ns):
            before = (queued + own.jitter_ns) // own.period_ns * own.transmission_ns
            ahead = self._queued(queued, own) + before
            if not ahead:
                continue
            # The last of them starts, and is over one frame later: at worst the shortest waits longest.
            wait = self._wait(wait, ahead - shortest, shortest)
            longest = max(longest, wait + shortest - queued)
        return longest

    def _times(self, own: Stream, busy: int, *, own_jitter_ns: int) -> Iterator[int]:
        """Since the start of the busy period: when a frame can be queued so that one more is ahead of it."""
        times = {0}
        for stream in self._own:
            jitter_ns = own_jitter_ns if stream is own else stream.jitter_ns
            first = -(-jitter_ns // stream.period_ns) * stream.period_ns - jitter_ns
            times.update(range(first, busy, stream.period_ns))
        yield from sorted(times)

    def _queued(self, window: int, but: Stream) -> int:
        """Time on the wire of the other streams of this queue, queued up to `window`, included."""
        return sum(
            ((window + stream.jitter_ns) // stream.period_ns + 1) * stream.transmission_ns
            for stream in self._own
            if stream is not but
        )

    def _interference(self, window: int) -> int:
        """Time on the wire of more urgent streams of others that are first in their queues by then."""
        return sum(
            -(-(window + late_ns) // stream.period_ns) * stream.transmission_ns
            for stream, late_ns in self._urgent
        )

    def _busy_period(self) -> int | None:
        """The longest time that the bus is busy with this level; None: no end."""
        busy = max(1, self._blocking)
        while busy <= BUSY_PERIOD_LIMIT_NS:
            longer = self._blocking + self._errors(busy) + self._interference(busy)
            for stream in self._own:
                longer += -(-(busy + stream.jitter_ns) // stream.period_ns) * stream.transmission_ns
            if longer == busy:
                return busy
            busy = longer
        return None

    def _wait(self, start: int, ahead: int, frame_ns: int) -> int:
        """When a frame with so much ahead of it wins arbitration, since the start of the busy period."""
        wait = start
        while True:
            longer = self._blocking + ahead + self._errors(wait + frame_ns)
            longer += self._interference(wait + self._bit_ns)
            if longer <= wait:
                return wait
            wait = longer
