"""Response-time bounds: the paper's counterexample, simulated buses that never exceed them, and tightness."""

from dataclasses import replace
from random import Random

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hil.canbus.analysis.frame_time import FD_LENGTHS, best_bits, worst_bits
from hil.canbus.analysis.message_set import message_set, priority
from hil.canbus.analysis.response_time import FaultHypothesis, Stream, bounds, schedulable
from hil.canbus.analysis.schedulability import Wire, streams
from hil.canbus.local.bits import INTERFRAME_BITS, frame_bits, worst_case_bits
from hil.canbus.local.medium import Medium, WireFrame
from hil.canbus.local.wire import BRS, FD

MS = 1_000_000


def stream(name, transmission_ms, period_ms, deadline_ms, jitter_ms=0.0):
    times = (round(MS * value) for value in (transmission_ms, period_ms, deadline_ms, jitter_ms))
    return Stream(name, *times)


def paper():
    """Davis et al. 2007, section 3.2: three frames of 125 bits at 125 kbit/s."""
    frame_ms = worst_bits(7).duration_ns(125_000) / MS
    return [
        stream("A", frame_ms, 2.5, 2.5),
        stream("B", frame_ms, 3.5, 3.25),
        stream("C", frame_ms, 3.5, 3.25),
    ]


def simulate(chosen, releases, until_ns):
    """A bus with given durations: waits in no queue, lowest index wins, not pre-emptive. Worst responses.

    `releases`: per stream a list of (due, queued) times. Independent of the bit-level model.
    """
    waiting = sorted(
        (queued, place, due)
        for place, times in enumerate(releases)
        for due, queued in times
        if queued < until_ns
    )
    worst = [0] * len(chosen)
    now = 0
    while waiting:
        now = max(now, min(queued for queued, _, _ in waiting))
        ready = [entry for entry in waiting if entry[0] <= now]
        entry = min(ready, key=lambda entry: (entry[1], entry[2]))
        waiting.remove(entry)
        now += chosen[entry[1]].transmission_ns
        worst[entry[1]] = max(worst[entry[1]], now - entry[2])
    return worst


def periodic(stream, phase, until, jitters=(0,) * 2000):
    return [
        (due, due + jitter)
        for due, jitter in zip(range(phase, until, stream.period_ns), jitters, strict=False)
    ]


# -- the paper's example -----------------------------------------------------------------------------------


def test_the_papers_counterexample_is_found_unschedulable():
    found = bounds(paper(), bit_ns=8_000)
    assert [bound.response_ns for bound in found] == [2_000_000, 3_000_000, 3_500_000]
    assert [bound.meets for bound in found] == [True, True, False]
    assert not schedulable(paper(), bit_ns=8_000)


def test_the_refuted_analysis_would_have_passed_it_as_it_looks_at_the_first_instance_only():
    worst = bounds(paper(), bit_ns=8_000)[2]
    assert (worst.instance, worst.instances) == (1, 2)
    assert worst.busy_period_ns == 7_000_000
    once = bounds([*paper()[:2], stream("C", 1.0, 1e4, 3.25)], bit_ns=8_000)[2]
    assert once.response_ns == 3_000_000  # what the first instance alone would give


def test_the_papers_counterexample_happens_on_a_simulated_bus():
    chosen = paper()
    releases = [periodic(one, 0, 7 * MS) for one in chosen]
    assert simulate(chosen, releases, 7 * MS)[2] == 3_500_000


# -- properties of the bound -------------------------------------------------------------------------------


@st.composite
def stream_sets(draw, jitter=True):
    """Streams of 5 to 25 time units; some sets ask for too much."""
    chosen = []
    for place in range(draw(st.integers(2, 5))):
        period = draw(st.integers(10, 120))
        chosen.append(
            Stream(
                f"m{place}",
                draw(st.integers(5, 25)),
                period,
                draw(st.integers(5, 300)),
                draw(st.integers(0, period // 2)) if jitter else 0,
            )
        )
    return chosen


@settings(max_examples=150, deadline=None)
@given(stream_sets(), st.data())
def test_no_simulated_response_exceeds_its_bound(chosen, data):
    found = bounds(chosen, bit_ns=1)
    until = 800
    releases = []
    for one in chosen:
        phase = data.draw(st.integers(0, one.period_ns))
        random = Random(data.draw(st.integers(0, 2**32)))
        jitters = [random.choice([0, one.jitter_ns, random.randint(0, one.jitter_ns)]) for _ in range(200)]
        releases.append(periodic(one, phase, until, jitters))
    for bound, seen in zip(found, simulate(chosen, releases, until), strict=True):
        if bound.response_ns is not None:
            assert seen <= bound.response_ns


@settings(max_examples=150, deadline=None)
@given(stream_sets(jitter=False))
def test_the_bound_of_the_least_urgent_is_reached_when_all_are_released_at_once(chosen):
    bound = bounds(chosen, bit_ns=1)[-1]
    assume(bound.response_ns is not None and bound.busy_period_ns < 20_000)
    until = bound.busy_period_ns + 1
    seen = simulate(chosen, [periodic(one, 0, until) for one in chosen], until)
    assert seen[-1] == bound.response_ns


@settings(max_examples=100, deadline=None)
@given(stream_sets(), st.integers(0, 4))
def test_more_jitter_never_lowers_a_bound(chosen, place):
    place %= len(chosen)
    later = list(chosen)
    later[place] = replace(chosen[place], jitter_ns=chosen[place].jitter_ns + 7)
    for one, other in zip(bounds(chosen, 1), bounds(later, 1), strict=True):
        if other.response_ns is not None:
            assert one.response_ns is not None
            assert one.response_ns <= other.response_ns


def test_errors_on_the_bus_delay_as_their_number_and_signalling_say():
    alone = [stream("A", 1.0, 10.0, 10.0)]
    calm, disturbed = (
        bounds(alone, 8_000, faults)[0].response_ns
        for faults in (None, FaultHypothesis(interval_ns=1000 * MS, burst=3))
    )
    assert disturbed - calm == 3 * (31 * 8_000 + 1_000_000)


def test_a_full_bus_has_no_bound_below_the_message_that_fills_it():
    found = bounds(
        [stream("A", 1.0, 2.0, 2.0), stream("B", 1.0, 2.0, 9.0), stream("C", 1.0, 50.0, 50.0)], 8_000
    )
    assert found[0].meets
    assert found[1].response_ns is None
    assert found[2].response_ns is None
    assert not found[2].meets
    assert found[2].slack_ns is None


def test_errors_as_often_as_frames_leave_no_bound():
    assert bounds([stream("A", 1.0, 10.0, 10.0)], 8_000, FaultHypothesis(1 * MS))[0].response_ns is None


def test_a_period_of_nothing_is_refused():
    with pytest.raises(ValueError, match="A: period"):
        bounds([stream("A", 1.0, 0.0, 1.0)], 8_000)


# -- frame lengths -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("length", range(9))
def test_the_longest_classic_frame_is_the_papers_equation_1(length, extended):
    assert worst_bits(length, extended=extended).nominal == (80 if extended else 55) + 10 * length
    assert worst_bits(length, extended=extended).nominal == worst_case_bits(length, extended=extended)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_every_real_frame_lies_between_the_shortest_and_the_longest(data):
    fd, extended = data.draw(st.booleans()), data.draw(st.booleans())
    payload = data.draw(st.sampled_from([b"\x00", b"\xff", b"\x0f", b"\x78", b"\x87", b"\xf0", b"\x3c"]))
    length = data.draw(st.sampled_from(FD_LENGTHS) if fd else st.integers(0, 8))
    content = data.draw(st.one_of(st.just(payload * length), st.binary(min_size=length, max_size=length)))
    can_id = data.draw(st.integers(0, 0x1FFF_FFFF if extended else 0x7FF))
    bits = frame_bits(can_id, content, extended=extended, fd=fd, brs=fd)
    worst, best = (f(length, extended=extended, fd=fd) for f in (worst_bits, best_bits))
    nominal = bits.nominal_bits + INTERFRAME_BITS
    assert best.nominal <= nominal <= worst.nominal
    assert best.data <= bits.data_bits
    assert nominal + bits.data_bits <= worst.nominal + worst.data


def test_a_length_that_no_frame_has_is_refused():
    with pytest.raises(ValueError, match="9 bytes: no classic CAN frame"):
        worst_bits(9)
    assert worst_bits(9, fd=True) == worst_bits(12, fd=True)


# -- the bit-level model of the wire -----------------------------------------------------------------------


@st.composite
def buses(draw):
    """Messages of random identifiers, lengths, periods and jitter, at a usual bit rate."""
    bitrate = draw(st.sampled_from([125_000, 250_000, 500_000, 1_000_000]))
    fd = draw(st.booleans())
    chosen = []
    for extended, number in draw(
        st.lists(st.tuples(st.booleans(), st.integers(0, 0x7FF)), min_size=2, max_size=7, unique=True)
    ):
        can_id = number << 18 | draw(st.integers(0, 0x3FFFF)) if extended else number
        length = draw(st.sampled_from(FD_LENGTHS) if fd else st.integers(0, 8))
        period = draw(st.integers(10, 200)) * 100_000 * 250_000 // bitrate
        jitter = draw(st.integers(0, period // 3))
        chosen.append((can_id, extended, length, period, jitter))
    chosen.sort(key=lambda entry: priority(entry[0], entry[1]))
    return bitrate, (4 * bitrate if fd else None), chosen


@settings(max_examples=150, deadline=None)
@given(buses(), st.sampled_from(["one node each", "one node for all"]), st.integers(0, 2**32))
def test_no_frame_on_the_wire_is_later_than_its_bound(bus, nodes, seed):
    random = Random(seed)
    bitrate, data_bitrate, chosen = bus
    fd = data_bitrate is not None
    bit_ns = 1_000_000_000 // bitrate
    found = bounds(
        [
            Stream(
                str(place),
                worst_bits(length, extended=extended, fd=fd).duration_ns(bitrate, data_bitrate),
                period,
                period,
                jitter,
            )
            for place, (_, extended, length, period, jitter) in enumerate(chosen)
        ],
        bit_ns,
    )
    queued = []
    for place, (can_id, extended, length, period, jitter) in enumerate(chosen):
        phase = random.choice([0, random.randrange(period)])
        for number in range(40):
            due = phase + number * period
            data = random.choice([b"\x78", b"\x0f", b"\x00", random.randbytes(1)]) * length
            frame = WireFrame(can_id | extended << 31, data, FD | BRS if fd else 0, tag=(place, due))
            queued.append((due + random.choice([0, jitter, random.randint(0, jitter)]), place, frame))
    queued.sort(key=lambda entry: entry[:2])
    medium = Medium(bitrate, data_bitrate, queue="priority")
    for time_ns, place, frame in queued:
        medium.submit(place if nodes == "one node each" else "all", frame, time_ns)
    done = medium.advance(queued[-1][0] + 100_000 * MS)
    assert len(done) == len(queued)
    for end_ns, _, frame in done:
        place, due = frame.tag
        bound = found[place]
        if bound.response_ns is not None:
            # A nanosecond for each frame ahead: the model rounds every duration to one.
            assert end_ns + INTERFRAME_BITS * bit_ns - due <= bound.response_ns + len(queued)


def most_stuffed(can_id, length):
    """Payload of this message with (nearly) the most stuff bits: rows of four, in the phase that fits."""
    rows = 0x0F0F_0F0F_0F0F_0F0F_0F0F
    candidates = [
        (rows >> shift & (1 << 8 * length) - 1 ^ last).to_bytes(length, "big")
        for shift in range(8)
        for last in range(0, 256, 5)
    ]
    return max(candidates, key=lambda data: frame_bits(can_id, data).nominal_bits)


def test_at_the_critical_instant_the_benchs_messages_come_close_to_their_bounds():
    bitrate, bit_ns = 500_000, 2_000
    chosen = message_set().messages
    found = bounds(streams(chosen, Wire(bitrate)), bit_ns)
    payloads = {m.name: most_stuffed(m.can_id, m.length) for m in chosen}
    for place, (message, bound) in enumerate(zip(chosen, found, strict=True)):
        medium = Medium(bitrate, queue="priority")
        lower = chosen[place + 1 :]
        if lower:  # has won arbitration just before
            longest = max(lower, key=lambda m: len(payloads[m.name]))
            medium.submit(longest.name, WireFrame(longest.can_id, payloads[longest.name]), 0)
        for other in chosen[: place + 1]:
            medium.submit(other.name, WireFrame(other.can_id, payloads[other.name]), 1)
        done = {frame.can_id: end_ns - 1 for end_ns, _, frame in medium.advance(1_000 * MS)}
        response = done[message.can_id] + INTERFRAME_BITS * bit_ns
        assert 0.9 * bound.response_ns <= response <= bound.response_ns, message.name


@pytest.mark.parametrize(("queue", "within"), [("priority", True), ("fifo", False)])
def test_the_bound_needs_that_the_most_urgent_frame_of_a_node_competes(queue, within):
    """What docs/bus.md warns of: behind its own node's other frames a command is later than its bound."""
    chosen = message_set().messages
    found = {b.stream.name: b for b in bounds(streams(chosen, Wire(250_000)), 4_000)}
    medium = Medium(250_000, queue=queue)
    own = [m for m in chosen if m.sender == "ATO"]
    for message in (
        *(m for m in own if m.name != "ATO_Command"),
        *(m for m in own if m.name == "ATO_Command"),
    ):
        medium.submit("ATO", WireFrame(message.can_id, most_stuffed(message.can_id, message.length)), 0)
    for message in chosen:
        if message.sender != "ATO":
            medium.submit(message.name, WireFrame(message.can_id, bytes(message.length)), 0)
    command = next(m for m in chosen if m.name == "ATO_Command")
    done = next(end for end, _, frame in medium.advance(1_000 * MS) if frame.can_id == command.can_id)
    assert (done <= found["ATO_Command"].response_ns) is within
