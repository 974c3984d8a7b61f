"""Can this bus carry these messages: bounds, loads, and from which bit rate on every deadline is met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hil.canbus.analysis.fifo_response_time import fifo_bounds
from hil.canbus.analysis.frame_time import NS_PER_S
from hil.canbus.analysis.message_set import BusMessage, MessageSet
from hil.canbus.analysis.queues import Queues
from hil.canbus.analysis.response_time import Bound, FaultHypothesis, Stream, bounds

USUAL_BITRATES = (10_000, 20_000, 50_000, 83_333, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""What controllers are set to [bit/s]: CiA 301's rates, and 83.3 and 100 kbit/s of vehicles."""

HIGHEST_BITRATE = 100_000_000
"""Where the search for a threshold ends: a set that is not schedulable here is so at no rate of CAN."""


@dataclass(frozen=True)
class Wire:
    """Bit rates [bit/s]; `data_bitrate` is that of CAN FD's data phase, None: no switch."""

    bitrate: int
    data_bitrate: int | None = None

    @property
    def bit_ns(self) -> int:
        """A nominal bit [ns], rounded up."""
        return -(-NS_PER_S // self.bitrate)

    def at(self, bitrate: int) -> Wire:
        """The same with another nominal bit rate; the data bit rate keeps its ratio."""
        if self.data_bitrate is None:
            return Wire(bitrate)
        return Wire(bitrate, max(1, self.data_bitrate * bitrate // self.bitrate))


@dataclass(frozen=True)
class Verdict:
    """One message: its bound, its share of the bus at worst and at best (0 to 1), the rate it needs.

    `needs_bitrate`: the lowest of `USUAL_BITRATES` at which it meets its deadline, None: none of them.
    """

    message: BusMessage
    bound: Bound
    worst_load: float
    best_load: float
    needs_bitrate: int | None


@dataclass(frozen=True)
class Analysis:
    """What `analyse` found; loads are fractions of the bus.

    `emptied_each_cycle`: whether a node that queues once per cycle, most urgent first, can rely on the bounds
    of `Queues("priority")`, because all that it queued has been sent when it queues again.
    `needs_bitrate`: the lowest usual rate at which all meet; `threshold_bitrate`: the exact one; None: there
    is none. `breakdown_load`: the worst-case load at that threshold, to which the set can be scaled.
    """

    messages: MessageSet
    wire: Wire
    queues: Queues
    faults: FaultHypothesis | None
    verdicts: tuple[Verdict, ...]
    worst_load: float
    best_load: float
    needs_bitrate: int | None
    threshold_bitrate: int | None
    breakdown_load: float | None
    emptied_each_cycle: bool

    @property
    def meets(self) -> bool:
        """Whether no message can ever miss its deadline."""
        return all(verdict.bound.meets for verdict in self.verdicts)


def streams(messages: Sequence[BusMessage], wire: Wire) -> list[Stream]:
    """The messages as the response-time analysis takes them, in the same order."""
    return [
        Stream(
            message.name,
            message.worst.duration_ns(wire.bitrate, wire.data_bitrate),
            message.period_ns,
            message.deadline_ns,
            message.jitter_ns,
        )
        for message in messages
    ]


def bounds_on(
    messages: MessageSet, wire: Wire, queues: Queues, faults: FaultHypothesis | None = None
) -> list[Bound]:
    """The bound of each message on this wire; MessageSetError: queues that the messages do not have."""
    names = queues.of(messages)
    chosen = streams(messages.messages, wire)
    if not any(names):
        return bounds(chosen, wire.bit_ns, faults)
    return fifo_bounds(chosen, names, wire.bit_ns, faults)


def analyse(
    messages: MessageSet,
    wire: Wire,
    faults: FaultHypothesis | None = None,
    queues: Queues | None = None,
) -> Analysis:
    """Bounds of all messages on this wire, and the bit rates at which they would meet their deadlines.

    Without `queues` each node has a first-in first-out queue. MessageSetError: queues that are not there.
    """
    queues = queues or Queues()
    chosen = messages.messages
    found = bounds_on(messages, wire, queues, faults)
    needs: dict[str, int] = {}
    for rate in USUAL_BITRATES:
        for bound in bounds_on(messages, wire.at(rate), queues, faults):
            if bound.meets:
                needs.setdefault(bound.stream.name, rate)
    verdicts = tuple(
        Verdict(
            message,
            bound,
            _load(message.worst.duration_ns(wire.bitrate, wire.data_bitrate), message),
            _load(message.best.duration_ns(wire.bitrate, wire.data_bitrate), message),
            needs.get(message.name),
        )
        for message, bound in zip(chosen, found, strict=True)
    )
    threshold = threshold_bitrate(messages, wire, queues, faults)
    worst = sum(verdict.worst_load for verdict in verdicts)
    return Analysis(
        messages,
        wire,
        queues,
        faults,
        verdicts,
        worst,
        sum(verdict.best_load for verdict in verdicts),
        max(needs.values()) if len(needs) == len(chosen) else None,
        threshold,
        None if threshold is None else worst * wire.bitrate / threshold,
        emptied_each_cycle(messages, wire, queues, faults),
    )


def emptied_each_cycle(
    messages: MessageSet, wire: Wire, queues: Queues, faults: FaultHypothesis | None = None
) -> bool:
    """Whether shared queues are empty whenever their node queues again, if it does so once per cycle.

    Then a queue that is filled most urgent first sends in the order of mailboxes. No circle: until the first
    time that a queue is not empty, all nodes are as with mailboxes, so no frame has been later than that
    bound; and a frame that is left over would have been, as the bound is no longer than the cycle.
    """
    names = queues.of(messages)
    shared = {name for name in names if name is not None}
    cycle_ns = {
        name: min(m.period_ns for m, other in zip(messages.messages, names, strict=True) if other == name)
        for name in shared
    }
    mailboxes = bounds(streams(messages.messages, wire), wire.bit_ns, faults)
    return bool(shared) and all(
        name is None or (bound.response_ns is not None and bound.response_ns <= cycle_ns[name])
        for name, bound in zip(names, mailboxes, strict=True)
    )


def threshold_bitrate(
    messages: MessageSet, wire: Wire, queues: Queues, faults: FaultHypothesis | None = None
) -> int | None:
    """The lowest bit rate [bit/s] at which all deadlines are met, by bisection; None: there is none.

    A higher rate shortens every term of the bound, so there is one threshold.
    """

    def fits(bitrate: int) -> bool:
        return all(bound.meets for bound in bounds_on(messages, wire.at(bitrate), queues, faults))

    low, high = 0, HIGHEST_BITRATE
    if not fits(high):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        if fits(middle):
            high = middle
        else:
            low = middle
    return high


def _load(transmission_ns: int, message: BusMessage) -> float:
    return transmission_ns / message.period_ns
