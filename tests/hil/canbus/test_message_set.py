"""What a DBC says about the load of a bus: nothing dropped in silence, every assumption named."""

from random import Random

import pytest

import dbc
from hil.canbus.analysis.message_set import MessageSetError, Reading, message_set, priority
from hil.canbus.analysis.queues import BENCH_TOGETHER, Queues
from hil.canbus.analysis.response_time import FaultHypothesis, bounds
from hil.canbus.analysis.schedulability import (
    HIGHEST_BITRATE,
    Wire,
    analyse,
    bounds_on,
    emptied_each_cycle,
    streams,
)
from hil.canbus.contract import ContractError
from hil.canbus.local.medium import Medium, WireFrame
from plant_sim.unit import PlantUnit

MS = 1_000_000

DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 256 Fast: 8 A
 SG_ X : 0|8@1+ (1,0) [0|255] "parsec" B
BO_ 257 Sudden: 4 A
 SG_ X : 0|8@1+ (1,0) [0|255] "" B
BO_ 258 Spaced: 2 B
 SG_ X : 0|8@1+ (1,0) [0|255] "" A
BO_ 2415919360 Wide: 8 B
 SG_ X : 0|8@1+ (1,0) [0|255] "" A
BO_ 259 Long: 20 B
 SG_ X : 0|8@1+ (1,0) [0|255] "" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "GenMsgDelayTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "GenMsgDelayTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 20;
BA_ "GenMsgDelayTime" BO_ 258 30;
BA_ "GenMsgCycleTime" BO_ 2415919360 50;
BA_ "GenMsgCycleTime" BO_ 259 100;
"""


@pytest.fixture
def mine(tmp_path):
    path = tmp_path / "mine.dbc"
    path.write_text(DBC)
    return path


def by_name(found):
    return {message.name: message for message in found.messages}


def test_every_message_of_the_bench_counts_or_is_left_out_with_a_reason():
    found = message_set()
    assert len(found.messages) + len(found.left_out) == 22
    assert found.left_out == dict.fromkeys(["SYNC", "ATO_SyncDone", "TCU_SyncDone"], "sent in lockstep only")
    assumed = {message.name for message in found.messages if message.assumption}
    assert assumed == {"ATO_Emergency", "TCU_Emergency", "BCU_Emergency", "ODO_Balise", "ATP_Restriction"}
    assert by_name(found)["ODO_Balise"].period_ns == 10 * MS


def test_messages_that_the_bench_cannot_decode_load_the_bus_too(mine):
    assert "Fast" in by_name(message_set(mine))  # its unit is unknown to the contract


def test_an_event_gets_its_interval_from_the_file_else_from_its_senders_cycle(mine):
    found = by_name(message_set(mine))
    assert (found["Spaced"].period_ns, found["Spaced"].assumption) == (30 * MS, "")
    assert found["Sudden"].period_ns == 20 * MS
    assert found["Sudden"].assumption == "at most one in 20 ms (the shortest cycle of A)"
    asked = by_name(message_set(mine, Reading(event_interval_ns=7 * MS)))
    assert (asked["Sudden"].period_ns, asked["Spaced"].period_ns) == (7 * MS, 30 * MS)


def test_messages_stand_in_the_order_of_arbitration(mine):
    assert [m.name for m in message_set(mine).messages] == ["Fast", "Sudden", "Spaced", "Long", "Wide"]
    assert priority(5, False) < priority(5 << 18, True) < priority(6, False)


def test_more_than_eight_bytes_are_can_fd(mine):
    assert [m.name for m in message_set(mine).messages if m.fd] == ["Long"]


def test_deadline_is_the_cycle_or_the_silence_limit():
    cycle, silence = (
        by_name(message_set(None, Reading(silence=flag)))["ODO_Motion"] for flag in (False, True)
    )
    assert (cycle.deadline_ns, silence.deadline_ns) == (10 * MS, 50 * MS)


def test_a_cycle_for_a_message_that_is_not_there_is_refused(mine):
    with pytest.raises(MessageSetError, match=r"mine\.dbc: no message 'Fats'; it has Fast, "):
        message_set(mine, Reading(cycles_ns={"Fats": MS}))


def test_events_only_need_an_interval_from_the_user(tmp_path):
    path = tmp_path / "events.dbc"
    path.write_text('VERSION ""\nBU_: A\nBO_ 1 E: 1 A\n SG_ X : 0|8@1+ (1,0) [0|255] "" A\n')
    with pytest.raises(MessageSetError, match="--event-interval"):
        message_set(path)
    assert message_set(path, Reading(event_interval_ns=MS)).messages[0].period_ns == MS


def test_a_file_that_is_no_dbc_is_refused(tmp_path):
    (tmp_path / "x.dbc").write_text("BO_ nonsense")
    with pytest.raises(ContractError, match=r"x\.dbc: not a valid DBC"):
        message_set(tmp_path / "x.dbc")


# -- bit rates ---------------------------------------------------------------------------------------------


def test_the_threshold_is_the_lowest_rate_that_meets():
    found = message_set()
    analysis = analyse(found, Wire(125_000), queues=Queues("priority"))
    assert not analysis.meets
    for rate, meets in ((analysis.threshold_bitrate, True), (analysis.threshold_bitrate - 1, False)):
        wire = Wire(rate)
        assert all(b.meets for b in bounds(streams(found.messages, wire), wire.bit_ns)) is meets
    assert analysis.needs_bitrate == 250_000
    assert analysis.breakdown_load == pytest.approx(
        analyse(found, Wire(analysis.threshold_bitrate)).worst_load, rel=1e-4
    )


# -- queues ------------------------------------------------------------------------------------------------


def test_the_benchs_plant_is_one_queue_as_it_is_one_client():
    assert (PlantUnit.nodes,) == BENCH_TOGETHER
    found = message_set()
    names = dict(zip([m.name for m in found.messages], Queues("auto", BENCH_TOGETHER).of(found), strict=True))
    assert names["TCU_Status"] == names["ATP_Heartbeat"] == "TCU+BCU+ODO+ATP"
    assert (names["ATO_Command"], names["BENCH_Heartbeat"]) == ("ATO", "BENCH")
    assert set(Queues("priority").of(found)) == {None}


def test_a_queue_of_more_nodes_makes_the_most_urgent_of_them_wait_longer():
    found = message_set()
    alone, shared = (
        {b.stream.name: b.response_ns for b in bounds_on(found, Wire(500_000), Queues("fifo", groups))}
        for groups in ((), (("TCU", "BCU", "ODO", "ATP"),))
    )
    mailboxes = {b.stream.name: b.response_ns for b in bounds_on(found, Wire(500_000), Queues("priority"))}
    assert mailboxes["TCU_Emergency"] < alone["TCU_Emergency"] < shared["TCU_Emergency"]


def test_a_node_with_mailboxes_by_its_dbc_is_no_fifo_unless_asked_for(tmp_path):
    path = tmp_path / "mailboxes.dbc"
    text = dbc.path().read_text().replace("\r\n", "\n")
    first = text.index("BA_DEF_DEF_ ")
    text = (
        text[:first]
        + 'BA_DEF_ BU_ "TransmitQueue" STRING ;\nBA_DEF_DEF_ "TransmitQueue" "";\n'
        + text[first:]
    )
    path.write_text(text + '\nBA_ "TransmitQueue" BU_ ATO "priority";\n')
    found = message_set(path)
    assert found.mailboxes == {"ATO"}
    command = next(number for number, m in enumerate(found.messages) if m.name == "ATO_Command")
    assert Queues("auto").of(found)[command] is None
    assert Queues("fifo").of(found)[command] == "ATO"
    with pytest.raises(MessageSetError, match="--together ATO: it has a mailbox per message"):
        Queues("auto", (("ATO", "TCU"),)).of(found)


@pytest.mark.parametrize("bitrate", [250_000, 500_000])
def test_queues_filled_once_per_cycle_in_order_keep_the_bounds_of_mailboxes(bitrate):
    """What `emptied_each_cycle` claims, on the wire: the bench's nodes, each cycle's frames in order."""
    found, queues = message_set(), Queues("auto", BENCH_TOGETHER)
    names = queues.of(found)
    assert emptied_each_cycle(found, Wire(bitrate), queues)
    limits = {b.stream.name: b.response_ns for b in bounds_on(found, Wire(bitrate), Queues("priority"))}
    for seed in range(20):
        random = Random(seed)
        phase = {name: random.randrange(10 * MS) for name in sorted(set(names))}
        queued = sorted(
            (phase[name] + cycle * 10 * MS, m.can_id, name, m)
            for name, m in zip(names, found.messages, strict=True)
            for cycle in range(random.randrange(m.period_ns // (10 * MS)), 60, m.period_ns // (10 * MS))
        )
        medium = Medium(bitrate, queue="fifo")
        for time_ns, can_id, name, m in queued:
            data = random.choice([b"\x78", b"\x0f"]) * m.length
            medium.submit(name, WireFrame(can_id, data, tag=(m.name, time_ns)), time_ns)
        for end_ns, _, frame in medium.advance(10_000 * MS):
            name, time_ns = frame.tag
            assert end_ns - time_ns <= limits[name]


def test_at_a_low_bit_rate_queues_are_not_empty_each_cycle():
    assert not emptied_each_cycle(message_set(), Wire(125_000), Queues("fifo"))


def test_the_load_of_the_bench_is_the_sum_of_its_frames():
    analysis = analyse(message_set(), Wire(500_000))
    by_hand_bits_per_s = 100 * (3 * 135 + 115 + 3 * 135 + 135) + 10 * (5 * 135 + 6 * 65)
    assert analysis.worst_load == pytest.approx(by_hand_bits_per_s / 500_000)
    assert sum(v.worst_load for v in analysis.verdicts) == pytest.approx(analysis.worst_load)


def test_a_set_that_no_rate_carries_has_no_threshold():
    found = message_set(None, Reading(jitter_ns=200 * MS))
    analysis = analyse(found, Wire(500_000))
    assert (analysis.needs_bitrate, analysis.threshold_bitrate, analysis.breakdown_load) == (None, None, None)
    assert Wire(500_000).at(HIGHEST_BITRATE).bit_ns == 10


def test_errors_raise_the_threshold():
    found = message_set()
    calm, disturbed = (
        analyse(found, Wire(250_000), faults).threshold_bitrate for faults in (None, FaultHypothesis(10 * MS))
    )
    assert disturbed > calm


def test_a_faster_data_phase_makes_long_frames_shorter():
    found = message_set(None, Reading(fd=True))
    slow, fast = (analyse(found, Wire(250_000, rate)).worst_load for rate in (250_000, 2_000_000))
    assert fast < 0.5 * slow
