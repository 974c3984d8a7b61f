"""Bounds for first-in first-out queues: never exceeded on simulated wires; with mailboxes, the other ones."""

from dataclasses import replace
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.canbus.analysis.fifo_response_time import fifo_bounds
from hil.canbus.analysis.frame_time import worst_bits
from hil.canbus.analysis.response_time import FaultHypothesis, Stream, bounds
from hil.canbus.local.bits import INTERFRAME_BITS
from hil.canbus.local.medium import Medium, WireFrame

MS = 1_000_000


@st.composite
def queued_streams(draw, largest=25, longest_period=160):
    """Streams of some time units, each in a queue or a mailbox; some sets ask for too much."""
    chosen, queues = [], []
    for place in range(draw(st.integers(2, 6))):
        period = draw(st.integers(10, longest_period))
        jitter = draw(st.integers(0, period // 2))
        deadline = draw(st.integers(5, 400))
        chosen.append(Stream(f"m{place}", draw(st.integers(5, largest)), period, deadline, jitter))
        queues.append(draw(st.sampled_from(["a", "b", "c", None])))
    return chosen, queues


def simulate(chosen, queues, releases, until):
    """A bus with given durations; each queue offers what it got first. Worst responses. No model of bits."""
    waiting = sorted(
        (queued, order, place, due)
        for place, times in enumerate(releases)
        for order, (due, queued) in enumerate(times)
        if queued < until
    )
    worst, now = [0] * len(chosen), 0
    while waiting:
        now = max(now, waiting[0][0])
        offered = {}
        for entry in waiting:
            if entry[0] <= now:
                name = queues[entry[2]]
                offered.setdefault(entry[2] if name is None else name, entry)
        entry = min(offered.values(), key=lambda entry: entry[2])
        waiting.remove(entry)
        now += chosen[entry[2]].transmission_ns
        worst[entry[2]] = max(worst[entry[2]], now - entry[3])
    return worst


def releases_of(chosen, seed, until):
    """Event and queueing times; each stream keeps the order of its events."""
    random = Random(seed)
    releases = []
    for one in chosen:
        phase = random.choice([0, random.randrange(one.period_ns)])
        kind = random.choice(["never late", "first late", "any"])
        times, last = [], 0
        for number, due in enumerate(range(phase, until, one.period_ns)):
            late = {
                "never late": 0,
                "first late": one.jitter_ns if number == 0 else 0,
                "any": random.randint(0, one.jitter_ns),
            }[kind]
            last = max(last, due + late)
            times.append((due, last))
        releases.append(times)
    return releases


@settings(max_examples=400, deadline=None)
@given(queued_streams(), st.integers(0, 2**32))
def test_no_simulated_response_exceeds_its_bound(chosen, seed):
    chosen, queues = chosen
    found = fifo_bounds(chosen, queues, bit_ns=1)
    seen = simulate(chosen, queues, releases_of(chosen, seed, 1200), 1200)
    for bound, response in zip(found, seen, strict=True):
        if bound.response_ns is not None:
            assert response <= bound.response_ns, bound.stream.name


@settings(max_examples=150, deadline=None)
@given(queued_streams(), st.sampled_from([None, FaultHypothesis(500), FaultHypothesis(900, 3)]))
def test_with_a_mailbox_each_it_is_the_priority_analysis(chosen, faults):
    chosen, _ = chosen
    plain = bounds(chosen, 1, faults)
    for names in ([None] * len(chosen), range(len(chosen))):
        for one, other in zip(fifo_bounds(chosen, names, 1, faults), plain, strict=True):
            assert (one.response_ns, one.blocking_ns) == (other.response_ns, other.blocking_ns)


@settings(max_examples=150, deadline=None)
@given(queued_streams())
def test_a_queue_never_makes_its_most_urgent_message_faster_than_a_mailbox(chosen):
    chosen, _ = chosen
    alone = bounds(chosen, 1)[0].response_ns
    for queues in (["a"] * len(chosen), ["a", *[None] * (len(chosen) - 2), "a"]):
        shared = fifo_bounds(chosen, queues, 1)[0].response_ns
        assert shared is None or shared >= alone


def test_three_frames_of_one_queue_by_hand():
    # B is first in its queue, A behind it; C, of another node, is more urgent than B but not than A.
    a, c, b = Stream("A", 10, 1000, 1000), Stream("C", 10, 1000, 1000), Stream("B", 10, 1000, 1000)
    found = fifo_bounds([a, c, b], ["node", "other", "node"], bit_ns=1)
    # A: C, B, A. C: B has just started; A, which had waited behind B, comes next.
    assert [bound.response_ns for bound in found] == [30, 30, 30]
    assert [bound.response_ns for bound in bounds([a, c, b], bit_ns=1)] == [20, 30, 30]
    assert [bound.buffering_ns for bound in found] == [20, 0, 20]


def test_waiting_in_its_queue_brings_two_frames_of_an_urgent_message_close_together():
    """What the buffering time is for: two A within less than a period, as one was held up behind B."""
    a, c, b = Stream("A", 10, 40, 1000), Stream("C", 10, 400, 1000), Stream("B", 10, 400, 1000)
    urgent = Stream("U", 10, 400, 1000)
    streams, queues = [urgent, a, c, b], [None, "node", None, "node"]
    late = fifo_bounds(streams, queues, 1)[2].response_ns
    assert late > bounds(streams, 1)[2].response_ns
    # The first A is queued behind B, which waits for U; then A, and the next A, before C.
    releases = [[(1, 1)], [(0, 0), (40, 40)], [(21, 21)], [(0, 0)]]
    assert simulate(streams, queues, releases, 400)[2] <= late


def test_a_queue_with_more_than_the_bus_carries_has_no_bound_and_spoils_those_below_its_urgent_messages():
    full = [Stream("A", 1, 10, 10), Stream("B", 1, 10, 10), Stream("C", 10, 11, 10)]
    found = fifo_bounds(full, ["node", None, "node"], 1)
    assert [bound.response_ns for bound in found] == [None, None, None]
    assert found[0].buffering_ns is None
    with pytest.raises(ValueError, match="1 queues for 3"):
        fifo_bounds(full, ["node"], 1)
    with pytest.raises(ValueError, match="A: period"):
        fifo_bounds([replace(full[0], period_ns=0)], [None], 1)


# -- the model of the wire that the local bus uses -----------------------------------------------------------


@st.composite
def buses(draw):
    """Messages with identifiers, lengths, periods and jitter; how many senders with one queue each."""
    bitrate = draw(st.sampled_from([125_000, 500_000]))
    numbers = draw(st.lists(st.integers(0, 0x7FF), min_size=3, max_size=9, unique=True))
    senders = draw(st.integers(1, 3))
    chosen = []
    for can_id in sorted(numbers):
        period = draw(st.integers(15, 200)) * 100_000 * 250_000 // bitrate
        jitter, sender = draw(st.integers(0, period // 3)), draw(st.integers(0, senders - 1))
        chosen.append((can_id, draw(st.integers(0, 8)), period, jitter, sender))
    return bitrate, chosen


def streams_on(bitrate, chosen):
    return [
        Stream(str(place), worst_bits(length).duration_ns(bitrate), period, period, jitter)
        for place, (_, length, period, jitter, _) in enumerate(chosen)
    ]


def responses_on_wire(bitrate, chosen, seed, count=30):
    """Worst response of each message through `Medium` with a queue per sender, ns; frames that were sent."""
    random = Random(seed)
    queued = []
    for place, (can_id, length, period, jitter, _) in enumerate(chosen):
        phase, last = random.choice([0, random.randrange(period)]), 0
        for number in range(count):
            due = phase + number * period
            data = random.choice([b"\x78", b"\x0f", b"\x00", random.randbytes(1)]) * length
            last = max(last, due + random.choice([0, jitter, random.randint(0, jitter)]))
            queued.append((last, random.random(), place, WireFrame(can_id, data, tag=(place, due))))
    queued.sort(key=lambda entry: entry[:2])
    medium = Medium(bitrate, queue="fifo")
    for time_ns, _, place, frame in queued:
        medium.submit(chosen[place][4], frame, time_ns)
    worst = [0] * len(chosen)
    done = medium.advance(queued[-1][0] + 100_000 * MS)
    assert len(done) == len(queued)
    gap_ns = INTERFRAME_BITS * 1_000_000_000 // bitrate
    for end_ns, _, frame in done:
        place, due = frame.tag
        worst[place] = max(worst[place], end_ns + gap_ns - due)
    return worst, len(done)


@settings(max_examples=150, deadline=None)
@given(buses(), st.integers(0, 2**32))
def test_no_frame_on_the_wire_of_nodes_with_one_queue_each_is_later_than_its_bound(bus, seed):
    bitrate, chosen = bus
    found = fifo_bounds(
        streams_on(bitrate, chosen), [entry[4] for entry in chosen], -(-1_000_000_000 // bitrate)
    )
    worst, frames = responses_on_wire(bitrate, chosen, seed)
    for bound, response in zip(found, worst, strict=True):
        if bound.response_ns is not None:
            # A nanosecond for each frame ahead: the model rounds every duration to one.
            assert response <= bound.response_ns + frames


def test_the_priority_analysis_is_exceeded_by_such_nodes():
    """So the property above says something: on the same kind of sets the other bound does not hold."""
    exceeded = 0
    for seed in range(60):
        random = Random(seed)
        chosen = [
            (100 * place, 8, random.randint(5, 20) * MS, 0, place % 2)
            for place in range(random.randint(4, 8))
        ]
        plain = bounds(streams_on(500_000, chosen), 2_000)
        worst, frames = responses_on_wire(500_000, chosen, seed)
        exceeded += any(
            bound.response_ns is not None and response > bound.response_ns + frames
            for bound, response in zip(plain, worst, strict=True)
        )
    assert exceeded > 10
