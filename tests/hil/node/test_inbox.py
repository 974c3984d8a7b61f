"""Inbox: whole messages or nothing, E2E, ages and time-outs."""

from __future__ import annotations

import pytest

from hil.canbus.contract import ContractError
from hil.canbus.protection import E2EStatus
from hil.node import Inbox

MS = 1_000_000
ODO = 0x184


@pytest.fixture
def inbox(contract):
    box = Inbox(contract, ["ODO_Motion", "ODO_Balise", "ATP_Permission", "ATO_Status"])
    box.begin(0)
    return box


@pytest.fixture
def motion(protected):
    return protected("ODO_Motion")


def test_start_values_hold_before_the_first_frame(contract, inbox):
    odo = inbox["ODO_Motion"]
    assert odo.values == dict(contract.message("ODO_Motion").start_values)
    assert (odo.received, odo.fresh, odo.valid) == (False, False, False)
    assert odo.status is E2EStatus.NO_NEW_DATA


def test_accepted_frame_gives_values_counter_and_age(inbox, motion):
    inbox.begin(20 * MS)
    motion(Position=0.0)
    inbox.accept(17 * MS, ODO, motion(Position=12.5, Speed=10.0))
    odo = inbox["ODO_Motion"]
    assert odo.values["Position"] == pytest.approx(12.5)
    assert odo.values["Speed"] == pytest.approx(10.0)
    assert (odo.received, odo.fresh, odo.valid, odo.counter, odo.ok) == (True, True, True, 1, 1)
    assert odo.age_ns() == 3 * MS
    assert odo.status in (E2EStatus.OK, E2EStatus.INITIAL)


def test_values_stay_and_age_grows_when_nothing_comes(inbox, motion):
    inbox.begin(10 * MS)
    inbox.accept(10 * MS, ODO, motion(Position=1.0))
    inbox.begin(20 * MS)
    odo = inbox["ODO_Motion"]
    assert odo.values["Position"] == pytest.approx(1.0)
    assert (odo.fresh, odo.status, odo.age_ns()) == (False, E2EStatus.NO_NEW_DATA, 10 * MS)


def test_corrupted_frame_changes_nothing(inbox, motion):
    inbox.begin(10 * MS)
    inbox.accept(10 * MS, ODO, motion(Position=1.0))
    before = dict(inbox["ODO_Motion"].values)
    inbox.begin(20 * MS)
    bad = bytearray(motion(Position=2.0))
    bad[4] ^= 0x10
    inbox.accept(20 * MS, ODO, bytes(bad))
    odo = inbox["ODO_Motion"]
    assert odo.values == before
    assert (odo.fresh, odo.status, odo.rejected, odo.ok) == (False, E2EStatus.WRONG_CRC, 1, 1)
    assert odo.age_ns() == 10 * MS


def test_replayed_frame_is_rejected_and_does_not_renew_the_age(inbox, motion):
    frame = motion(Position=1.0)
    inbox.begin(0)
    inbox.accept(0, ODO, frame)
    for k in range(1, 8):
        inbox.begin(k * 10 * MS)
        inbox.accept(k * 10 * MS, ODO, frame)
    odo = inbox["ODO_Motion"]
    assert (odo.status, odo.rejected, odo.ok) == (E2EStatus.REPEATED, 7, 1)
    assert odo.age_ns() == 70 * MS
    assert odo.timed_out()
    assert odo.faulty
    assert not odo.valid


def test_many_bad_frames_make_a_message_invalid_before_it_times_out_and_good_ones_heal_it(inbox, motion):
    odo = inbox["ODO_Motion"]
    inbox.begin(10 * MS)
    inbox.accept(10 * MS, ODO, motion())
    assert odo.valid
    for _ in range(5):
        assert odo.valid
        inbox.accept(10 * MS, ODO, bytes(8))
    assert not odo.timed_out()
    assert not odo.valid
    inbox.accept(10 * MS, ODO, motion())
    assert odo.valid


@pytest.mark.parametrize("length", [0, 7, 9])
@pytest.mark.parametrize("name", ["ODO_Motion", "ATO_Status"])
def test_frame_of_the_wrong_length_is_rejected(contract, inbox, name, length):
    inbox.begin(MS)
    inbox.accept(MS, contract.message(name).can_id, bytes(length))
    assert (inbox[name].rejected, inbox[name].received) == (1, False)
    assert inbox[name].values == dict(contract.message(name).start_values)


def test_one_good_frame_among_bad_ones_is_taken(inbox, motion):
    inbox.begin(10 * MS)
    inbox.accept(10 * MS, ODO, bytes(8))
    inbox.accept(10 * MS, ODO, motion(Position=3.0))
    inbox.accept(10 * MS, ODO, b"\xff" * 8)
    odo = inbox["ODO_Motion"]
    assert odo.values["Position"] == pytest.approx(3.0)
    assert (odo.fresh, odo.ok, odo.rejected) == (True, 1, 2)


def test_lost_frames_are_counted(inbox, motion):
    inbox.begin(10 * MS)
    inbox.accept(10 * MS, ODO, motion())
    motion()
    inbox.accept(10 * MS, ODO, motion())
    odo = inbox["ODO_Motion"]
    assert (odo.status, odo.lost, odo.ok) == (E2EStatus.OK_SOME_LOST, 1, 2)


def test_silence_up_to_the_limit_is_no_timeout(contract, inbox, motion):
    limit = contract.message("ODO_Motion").timeout_ns
    inbox.begin(MS)
    inbox.accept(MS, ODO, motion())
    inbox.begin(MS + limit)
    assert not inbox["ODO_Motion"].timed_out()
    inbox.begin(MS + limit + 1)
    assert inbox["ODO_Motion"].timed_out()
    assert not inbox["ODO_Motion"].valid


def test_each_silence_is_counted_once(contract, inbox, motion):
    limit = contract.message("ODO_Motion").timeout_ns
    now = 0
    for _ in range(2):
        inbox.begin(now)
        inbox.accept(now, ODO, motion())
        for _ in range(5):
            now += limit
            inbox.begin(now)
        now += limit
    inbox.begin(now)
    assert inbox["ODO_Motion"].timeouts == 2


def test_message_that_never_comes_times_out_counted_from_the_start(contract):
    box = Inbox(contract, ["ODO_Motion"])
    limit = contract.message("ODO_Motion").timeout_ns
    box.begin(10**15)
    assert not box["ODO_Motion"].timed_out()
    box.begin(10**15 + limit + 1)
    assert box["ODO_Motion"].timed_out()


def test_stamp_in_the_future_is_age_zero(inbox, motion):
    inbox.begin(10 * MS)
    inbox.accept(11 * MS, ODO, motion())
    assert inbox["ODO_Motion"].age_ns() == 0


def test_events_of_one_cycle_queue_and_are_gone_in_the_next(inbox, protected):
    balise = protected("ODO_Balise")
    inbox.begin(10 * MS)
    for number in (3, 4):
        inbox.accept(10 * MS, 0x284, balise(Number=number, Position=100.0 * number))
    assert [event["Number"] for event in inbox["ODO_Balise"].events] == [3, 4]
    inbox.begin(20 * MS)
    assert inbox["ODO_Balise"].events == []


def test_cyclic_messages_do_not_queue(inbox, motion):
    inbox.begin(10 * MS)
    inbox.accept(10 * MS, ODO, motion())
    inbox.accept(10 * MS, ODO, motion())
    assert inbox["ODO_Motion"].events == []


def test_event_message_has_no_timeout(inbox):
    inbox.begin(10**12)
    assert not inbox["ODO_Balise"].timed_out()


def test_unprotected_message_is_taken_as_it_is(contract, inbox):
    codec = contract.message("ATO_Status")
    inbox.begin(MS)
    inbox.accept(MS, codec.can_id, bytes(codec.encode({"ReferenceSpeed": 5.0})))
    status = inbox["ATO_Status"]
    assert status.values["ReferenceSpeed"] == pytest.approx(5.0, abs=0.01)
    assert (status.status, status.ok, status.valid) == (E2EStatus.OK, 1, True)


def test_worst_age_is_that_of_the_oldest_cyclic_message_received(inbox, motion, protected):
    assert inbox.worst_age_ns() == 0
    inbox.begin(100 * MS)
    inbox.accept(10 * MS, 0x284, protected("ODO_Balise")())
    inbox.accept(95 * MS, ODO, motion())
    assert inbox.worst_age_ns() == 5 * MS
    inbox.accept(60 * MS, 0x185, protected("ATP_Permission")())
    assert inbox.worst_age_ns() == 40 * MS


def test_unknown_identifier_is_ignored(inbox):
    inbox.begin(MS)
    inbox.accept(MS, 0x555, b"abc")
    assert all(not received.received for received in inbox.messages.values())


def test_message_that_the_contract_lacks_is_an_error(contract):
    with pytest.raises(ContractError, match="No_Such"):
        Inbox(contract, ["ODO_Motion", "No_Such"])
