"""The wire as a model: arbitration, wire time, errors, error counters, bus-off. No clock, no sockets."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.canbus.local.bits import INTERFRAME_BITS, frame_bits
from hil.canbus.local.confinement import State
from hil.canbus.local.medium import (
    Completed,
    Dropped,
    Medium,
    Reported,
    WireFrame,
    arbitration_field,
    bits_of,
)
from hil.canbus.local.wire import EXTENDED, FD, REMOTE

BIT_NS = 2_000  # 500 kbit/s
S = 1_000_000_000
ERR_CRTL, ERR_ACK, ERR_BUSOFF, ERR_BUSERROR, ERR_RESTARTED = 0x4, 0x20, 0x40, 0x80, 0x100  # linux/can/error.h


def two_nodes(**options):
    medium = Medium(500_000, listeners=0, **options)
    medium.join("a")
    medium.join("b")
    return medium


def duration_ns(frame):
    return bits_of(frame).total * BIT_NS


# -- arbitration ------------------------------------------------------------------------------------------


def arbitration_bits(can_id):
    """What is on the wire up to the end of the arbitration field, as a text of 0 and 1."""
    remote = str(int(bool(can_id & REMOTE)))
    if can_id & EXTENDED:
        digits = f"{can_id & 0x1FFFFFFF:029b}"
        return digits[:11] + "11" + digits[11:] + remote
    return f"{can_id & 0x7FF:011b}" + remote + "0"


@given(st.lists(st.integers(0, (1 << 30) - 1), min_size=2, max_size=2))
def test_arbitration_is_won_by_the_first_dominant_bit(numbers):
    ids = []
    for value in numbers:
        remote = REMOTE if value & 1 else 0
        extended = value >> 1 & 1
        base = value >> 2 & 0x3  # few different ones, so that longer parts decide
        ids.append(remote | (EXTENDED | base << 18 | (value >> 4 & 0x7) if extended else base))
    a, b = ids
    text_a, text_b = arbitration_bits(a), arbitration_bits(b)
    for bit_a, bit_b in zip(text_a, text_b, strict=False):
        if bit_a != bit_b:
            assert (arbitration_field(a) < arbitration_field(b)) == (bit_a == "0")
            return
    assert a == b


def test_standard_wins_over_extended_of_equal_base_and_data_over_remote():
    base = 0x123
    ids = [
        base,
        base | REMOTE,
        EXTENDED | base << 18,
        EXTENDED | base << 18 | REMOTE,
        EXTENDED | base << 18 | 1,
    ]
    for order in (ids, ids[::-1]):
        medium = Medium(500_000)
        for can_id in order:
            medium.submit(can_id, WireFrame(can_id), 0)
        assert [done.frame.can_id for done in medium.advance(S)] == ids


def test_lowest_identifier_waits_for_the_frame_on_the_wire():
    medium = Medium(500_000)
    late = WireFrame(0x7FF, bytes(8))
    medium.submit("low priority", late, 0)
    medium.advance(0)
    medium.submit("middle", WireFrame(0x100), 10_000)
    medium.submit("urgent", WireFrame(0x001), 20_000)
    done = medium.advance(S)
    assert [entry.frame.can_id for entry in done] == [0x7FF, 0x001, 0x100]
    assert done[0].end_of_frame_ns == duration_ns(late)
    assert done[1].end_of_frame_ns == duration_ns(late) + 3 * BIT_NS + duration_ns(WireFrame(0x001))


@pytest.mark.parametrize(("queue", "order"), [("fifo", [5, 1, 3]), ("priority", [1, 3, 5])])
def test_what_a_node_offers_first(queue, order):
    medium = Medium(500_000, queue=queue)
    for can_id in (5, 1, 3):
        medium.submit("one", WireFrame(can_id), 0)
    assert [entry.frame.can_id for entry in medium.advance(S)] == order


def test_more_urgent_frame_of_the_same_node_does_not_replace_the_one_on_the_wire():
    medium = Medium(500_000, queue="priority")
    medium.submit("one", WireFrame(5), 0)
    medium.advance(0)
    medium.submit("one", WireFrame(1), 1_000)
    assert [entry.frame.can_id for entry in medium.advance(S)] == [5, 1]


frames = st.builds(
    lambda can_id, extended, data: WireFrame(can_id | EXTENDED if extended else can_id & 0x7FF, data),
    st.integers(0, 0x1FFF_FFFF),
    st.booleans(),
    st.binary(max_size=8),
)
arrivals = st.lists(st.tuples(st.integers(0, 3_000_000), st.integers(0, 3), frames), min_size=1, max_size=30)


@settings(max_examples=150, deadline=None)
@given(arrivals, st.sampled_from(["fifo", "priority"]), st.integers(20_000, 400_000))
def test_wire_is_never_shared_never_idle_while_a_frame_waits_and_obeys_priority(queued, queue, step_ns):
    queued.sort(key=lambda entry: entry[0])
    medium = Medium(500_000, queue=queue)
    done = []
    pending = [(t, node, frame._replace(tag=number)) for number, (t, node, frame) in enumerate(queued)]
    for time_ns, node, frame in pending:
        medium.submit(node, frame, time_ns)
    now_ns = 0
    while len(done) < len(pending):  # how often the model is asked must not matter
        now_ns += step_ns
        done += medium.advance(now_ns)
    waiting = {frame.tag: (time_ns, node, frame) for time_ns, node, frame in pending}
    free_ns = 0
    for end_ns, node, frame in done:
        start_ns = end_ns - duration_ns(frame)
        assert start_ns == max(free_ns, min(entry[0] for entry in waiting.values()))
        ready = [entry for entry in waiting.values() if entry[0] <= start_ns]
        if queue == "fifo":
            first = {}
            for entry in sorted(ready, key=lambda entry: entry[2].tag):
                first.setdefault(entry[1], entry)
            ready = list(first.values())
        assert arbitration_field(frame.can_id) == min(arbitration_field(e[2].can_id) for e in ready)
        assert waiting.pop(frame.tag)[1] == node
        free_ns = end_ns + INTERFRAME_BITS * BIT_NS
    busy_ns = sum(duration_ns(frame) + INTERFRAME_BITS * BIT_NS for _, _, frame in done)
    assert medium.traffic.busy_ns == busy_ns


def test_bit_rate_switch_takes_the_data_bit_rate_for_its_part():
    frame = WireFrame(0x10, bytes(64), FD | 1)
    bits = frame_bits(0x10, bytes(64), fd=True, brs=True)
    medium = Medium(500_000, 2_000_000)
    medium.submit("a", frame, 0)
    assert medium.advance(S)[0].end_of_frame_ns == bits.nominal_bits * 2_000 + bits.data_bits * 500


# -- load -------------------------------------------------------------------------------------------------


def test_load_is_the_share_of_the_frames_with_their_interframe_space():
    medium = Medium(500_000)
    bits = 0
    rng = random.Random(3)
    for number in range(2_000):
        frame = WireFrame(rng.randrange(0x800), rng.randbytes(8))
        bits += bits_of(frame).total + 3
        medium.submit("a", frame, number * 1_000_000)
    medium.advance(2 * S)
    assert medium.load() == pytest.approx(bits / 500_000 / 2.0, rel=1e-12)
    assert medium.load(500_000_000) == pytest.approx(medium.load(), rel=0.02)
    told = medium.statistics()["messages"]
    assert sum(message["bits"] for message in told.values()) <= bits  # the statistics name the heaviest ones
    assert sum(entry.bits for entry in medium.traffic.messages.values()) == bits


# -- errors -----------------------------------------------------------------------------------------------


def test_disturbed_frame_is_sent_again_after_its_error_frame():
    medium = two_nodes()
    frame = WireFrame(0x55, b"\x12\x34")
    medium.corrupt(count=1, bit=20)
    medium.submit("a", frame, 0)
    events = medium.events(S)
    # 21 bits of the frame, error flag and its echo, error delimiter, interframe space.
    again_ns = (21 + 12 + 8 + 3) * BIT_NS
    assert [event.end_of_frame_ns for event in events if isinstance(event, Completed)] == [
        again_ns + duration_ns(frame)
    ]
    reported = {event.node: event.notice for event in events if isinstance(event, Reported)}
    assert reported["a"].classes & ERR_BUSERROR
    assert reported["a"].data[6:] == bytes((8, 0))
    assert reported["b"].data[6:] == bytes((0, 1))
    assert (medium.confinement("a").tec, medium.confinement("b").rec) == (7, 0)


def test_error_counters_follow_the_standard_up_to_bus_off():
    medium = two_nodes(restart_ns=None)
    hit = medium.corrupt(sender="a")
    medium.submit("a", WireFrame(1), 0)
    medium.submit("a", WireFrame(2), 0)
    events = medium.events(S)
    assert hit.failed == 32  # 32 x 8 = 256
    assert medium.confinement("a").state is State.BUS_OFF
    assert medium.confinement("b").rec == 32
    states = [
        e.notice for e in events if isinstance(e, Reported) and e.node == "a" and not e.notice.classes & 0x8
    ]
    assert [(notice.classes & ~0x200, notice.data[1]) for notice in states] == [
        (ERR_CRTL, 0x08),  # transmit warning at 96
        (ERR_CRTL, 0x20),  # transmit passive at 128
        (ERR_BUSOFF, 0),
    ]
    assert [notice.data[6] for notice in states] == [96, 128, 255]
    assert [event.frame.can_id for event in events if isinstance(event, Dropped)] == [1, 2]
    assert not medium.submit("a", WireFrame(3), 2 * S)
    assert medium.next_event_ns() is None  # without a restart for ever


def test_bus_off_ends_after_the_restart_time_and_128_times_11_recessive_bits():
    medium = two_nodes(restart_ns=50_000_000)
    medium.corrupt(sender="a", bit=5)
    medium.submit("a", WireFrame(1), 0)
    events = medium.events(S)
    off_ns = next(e.time_ns for e in events if isinstance(e, Reported) and e.notice.classes & ERR_BUSOFF)
    back_ns = next(e.time_ns for e in events if isinstance(e, Reported) and e.notice.classes & ERR_RESTARTED)
    assert back_ns == off_ns + 50_000_000 + 128 * 11 * BIT_NS
    assert medium.confinement("a").state is State.ACTIVE
    assert medium.confinement("a").tec == 0
    medium.corrupt_no_more()
    assert medium.submit("a", WireFrame(1), 2 * S)
    assert len(medium.advance(3 * S)) == 1


def test_on_a_busy_bus_each_frame_counts_as_one_sequence_of_11_recessive_bits():
    medium = two_nodes(restart_ns=0)
    medium.join("c")
    medium.corrupt(sender="a", bit=5)
    medium.submit("a", WireFrame(1), 0)
    for number in range(300):
        medium.submit("b", WireFrame(2, bytes(8), tag=number), 0)
    events = medium.events(2 * S)
    off_ns = next(e.time_ns for e in events if isinstance(e, Reported) and e.notice.classes & ERR_BUSOFF)
    back_ns = next(e.time_ns for e in events if isinstance(e, Reported) and e.notice.classes & ERR_RESTARTED)
    # From the ACK delimiter to the interframe space.
    ends = [e.end_of_frame_ns for e in events if isinstance(e, Completed)]
    assert sum(off_ns < end_ns <= back_ns for end_ns in ends) == 128


def test_lone_sender_stays_error_passive_and_is_heard_by_who_comes():
    medium = Medium(500_000, listeners=0)
    medium.join("alone")
    medium.submit("alone", WireFrame(0x10, b"x"), 0)
    events = medium.events(S)
    assert not any(isinstance(event, Completed) for event in events)
    acknowledge = [e.notice for e in events if isinstance(e, Reported) and e.notice.classes & ERR_ACK]
    assert [notice.data[6] for notice in acknowledge] == [8 * n for n in range(1, 17)]
    counters = medium.confinement("alone")
    assert (counters.tec, counters.state) == (128, State.PASSIVE)
    assert medium.next_event_ns() is None  # repeated without an event
    medium.events(3600 * S)
    assert (counters.tec, counters.state) == (128, State.PASSIVE)
    medium.join("listener", 3600 * S)
    done = medium.advance(3601 * S)
    assert len(done) == 1
    assert done[0].end_of_frame_ns - 3600 * S < 1_000_000
    assert counters.tec == 127


def test_repetitions_of_a_lone_sender_do_not_depend_on_how_often_the_model_is_asked():
    outcomes = []
    for step_ns in (77_777, 1_000_000, 50_000_000):
        medium = Medium(500_000, listeners=0)
        medium.submit("alone", WireFrame(0x10, b"x"), 0)
        for now_ns in range(0, 100_000_000, step_ns):
            medium.events(now_ns)
        medium.join("listener", 100_000_000)
        done = medium.advance(S)
        outcomes.append((done[0].end_of_frame_ns, medium.traffic.failed_frames, medium.traffic.busy_ns))
    assert len(set(outcomes)) == 1


def test_error_passive_sender_lets_others_go_first():
    medium = Medium(500_000, listeners=0)
    medium.submit("a", WireFrame(1), 0)
    medium.events(100_000_000)  # passive now
    medium.join("b", 100_000_000)
    for can_id in (1, 1):
        medium.submit("a", WireFrame(can_id), 100_000_000)
    medium.submit("b", WireFrame(0x700), 100_000_000)
    done = [entry.frame.can_id for entry in medium.advance(S)]
    assert done[:2] == [0x700, 1] or done[:2] == [1, 0x700]
    assert done[-1] == 1


def test_same_seed_disturbs_the_same_transmissions():
    def ends(seed):
        medium = two_nodes(seed=seed)
        medium.corrupt(probability=0.2)
        for number in range(200):
            medium.submit("a", WireFrame(number), number * 300_000)
        return [entry.end_of_frame_ns for entry in medium.advance(S)]

    assert ends(1) == ends(1)
    assert ends(1) != ends(2)


def test_choice_of_what_is_disturbed():
    medium = two_nodes()
    medium.corrupt(can_id=0x7, count=1)
    hit = medium.corrupt(choose=lambda sender, can_id, data: data == b"\x01", count=1)
    for can_id, data in ((7, b""), (8, b"\0"), (9, b"\1")):
        medium.submit("a", WireFrame(can_id, data), 0)
    assert len(medium.advance(S)) == 3
    assert medium.statistics()["nodes"][0]["retransmissions"] == 2
    assert hit.failed == 1


def test_equal_identifiers_at_one_instant_are_counted():
    medium = two_nodes()
    for node in "ab":
        medium.submit(node, WireFrame(0x10, node.encode()), 0)
    assert [entry.sender for entry in medium.advance(S)] == ["a", "b"]
    assert medium.collisions == 1


def test_equal_identifiers_that_both_lose_have_not_met_yet():
    medium = two_nodes()
    for node, can_id in (("a", 0x200), ("b", 0x200), ("c", 0x100)):
        medium.submit(node, WireFrame(can_id, node.encode()), 0)
    assert [entry.sender for entry in medium.advance(S)] == ["c", "a", "b"]
    assert medium.collisions == 1


@pytest.mark.parametrize("rates", [(0, None), (-1, None), (500_000, 0)])
def test_bit_rate_has_to_be_above_0(rates):
    with pytest.raises(ValueError, match="must be above 0"):
        Medium(*rates)
