"""Outbox: which message goes out in which cycle, and with which counter."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.canbus.contract import Contract, ContractError, EncodeError
from hil.canbus.protection import E2EStatus, Receiver
from hil.node import Outbox

MS = 1_000_000
CONTRACT = Contract.load()
CYCLIC = ("ATO_Command", "ATO_Status", "ATO_Position", "ATO_Timing")
HEARTBEAT = 0x701


def filled(period_ns, nodes=("ATO",), names=CYCLIC, **options):
    box = Outbox(CONTRACT, nodes, period_ns, **options)
    for name in names:
        box.put(name, {})
    return box


def cycles_of(box, cycles):
    """Cycles in which each identifier was sent."""
    sent = {}
    for k in range(cycles):
        for can_id, _ in box.collect(k):
            sent.setdefault(can_id, []).append(k)
    return sent


@given(period_ms=st.sampled_from([1, 2, 4, 5, 8, 10, 20, 30, 40, 50, 100, 200]))
def test_every_message_keeps_its_cycle_time_at_any_period(period_ms):
    sent = cycles_of(filled(period_ms * MS), 400)
    for name in CYCLIC:
        codec = CONTRACT.message(name)
        every = max(1, round(codec.cycle_ns / (period_ms * MS)))
        first = sent[codec.can_id][0]
        assert first < every
        assert sent[codec.can_id] == list(range(first, 400, every))


def test_message_as_fast_as_the_unit_goes_out_every_cycle():
    assert cycles_of(filled(10 * MS), 30)[0x181] == list(range(30))


def test_message_faster_than_the_unit_goes_out_every_cycle():
    assert cycles_of(filled(20 * MS), 30)[0x181] == list(range(30))


def test_message_named_by_the_unit_goes_out_every_cycle():
    assert cycles_of(filled(1 * MS, every_cycle=("ATO_Command",)), 30)[0x181] == list(range(30))


def test_slow_messages_are_spread_over_the_cycles():
    box = filled(10 * MS)
    box.collect(0)
    load = [len(box.collect(k)) for k in range(10, 20)]
    assert max(load) == 2
    assert sum(load) == 10 + 4  # ATO_Command ten times; three slow messages and the heartbeat once


def test_message_is_silent_until_the_unit_has_put_it():
    box = Outbox(CONTRACT, ["ATO"], 10 * MS)
    assert set(cycles_of(box, 20)) == {HEARTBEAT}
    box.put("ATO_Command", {})
    assert 0x181 in {can_id for can_id, _ in box.collect(20)}


def test_last_values_are_sent_again_when_due():
    box = Outbox(CONTRACT, ["ATO"], 10 * MS)
    box.put("ATO_Command", {"EffortDemand": -0.25})
    codec = CONTRACT.message("ATO_Command")
    for k in range(3):
        data = dict(box.collect(k))[codec.can_id]
        assert codec.decode(data)["EffortDemand"] == pytest.approx(-0.25)


def test_counter_increments_from_frame_to_frame_and_a_receiver_agrees():
    box = filled(10 * MS)
    codec = CONTRACT.message("ATO_Command")
    receiver = Receiver(codec.protection, length=codec.length)
    statuses = [receiver.check(dict(box.collect(k))[codec.can_id]) for k in range(40)]
    assert receiver.accepted(statuses[0])
    assert set(statuses[1:]) == {E2EStatus.OK}


def test_frames_of_a_cycle_are_in_ascending_order_of_identifiers():
    box = filled(100 * MS)
    for k in range(3):
        box.event("ATO_Emergency", {"ErrorCode": 0x1000})
        identifiers = [can_id for can_id, _ in box.collect(k)]
        assert identifiers == sorted(identifiers)
        assert identifiers[0] == 0x081


def test_event_is_sent_once_and_events_keep_their_order():
    box = Outbox(CONTRACT, ["ATO"], 10 * MS)
    box.collect(0)
    for code in (0xFF01, 0x1000, 0):
        box.event("ATO_Emergency", {"ErrorCode": code})
    codec = CONTRACT.message("ATO_Emergency")
    sent = [codec.decode(data)["ErrorCode"] for can_id, data in box.collect(1) if can_id == codec.can_id]
    assert sent == [0xFF01, 0x1000, 0]
    assert codec.can_id not in dict(box.collect(2))


def test_every_node_played_boots_up_first_and_is_operational_then():
    nodes = ("TCU", "BCU", "ODO", "ATP")
    box = Outbox(CONTRACT, nodes, 10 * MS)
    states = {}
    for k in range(40):
        for can_id, data in box.collect(k):
            message = CONTRACT.by_id[can_id]
            states.setdefault(message.sender, []).append((k, message.decode(data)["NmtState"]))
    assert set(states) == set(nodes)
    for history in states.values():
        assert history[0] == (0, 0)
        assert {state for _, state in history[1:]} == {5}
        later = [k for k, _ in history[1:]]
        assert all(after - before == 10 for before, after in itertools.pairwise(later))
        assert len(later) >= 3


def test_same_puts_give_the_same_frames():
    def run():
        box = filled(10 * MS)
        return [box.collect(k) for k in range(50)]

    assert run() == run()


def test_flush_sends_what_was_put_since_the_last_cycle_after_the_heartbeats():
    box = filled(10 * MS)
    box.collect(0)
    box.put("ATO_Command", {"EffortDemand": -1.0})
    box.event("ATO_Emergency", {"ErrorCode": 0x1000})
    frames = box.flush()
    assert [can_id for can_id, _ in frames] == [HEARTBEAT, 0x081, 0x181]
    assert CONTRACT.by_id[HEARTBEAT].decode(frames[0][1])["NmtState"] == 4
    assert CONTRACT.by_id[0x181].decode(frames[2][1])["EffortDemand"] == pytest.approx(-1.0)


def test_value_that_does_not_fit_is_an_error():
    box = Outbox(CONTRACT, ["ATO"], 10 * MS)
    box.put("ATO_Command", {"EffortDemand": 1.5})
    with pytest.raises(EncodeError, match=r"ATO_Command.*EffortDemand"):
        box.collect(0)


def test_message_of_another_node_cannot_be_put():
    with pytest.raises(ContractError, match="ODO_Motion is sent by ODO, not by ATO"):
        Outbox(CONTRACT, ["ATO"], 10 * MS).put("ODO_Motion", {})


def test_event_message_cannot_be_put_as_cyclic():
    with pytest.raises(ContractError, match="no cycle time"):
        Outbox(CONTRACT, ["ATO"], 10 * MS).put("ATO_Emergency", {})


@pytest.mark.parametrize(("nodes", "period"), [(("XYZ",), MS), (("ATO",), 0)])
def test_impossible_nodes_and_periods_are_refused(nodes, period):
    with pytest.raises(ValueError, match=r"no node|must be greater"):
        Outbox(CONTRACT, nodes, period)


def test_heartbeat_is_the_nodes_own_business():
    with pytest.raises(ContractError, match="sent by the node"):
        Outbox(CONTRACT, ["ATO"], 10 * MS).put("ATO_Heartbeat", {"NmtState": 5})
