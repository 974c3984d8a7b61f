"""Events come from the contract alone: states, event messages, silence."""

from __future__ import annotations

import numpy as np
import pytest

from hil.canbus.frame import Frame
from hil.record.blocks import decode_block
from hil.record.dashboard import level_of
from hil.record.events import EventDetector, is_state

MS = 1_000_000


@pytest.fixture
def scan(contract):
    """Sends (time in ms, message, values), …; gives the block's events and state changes; remembers."""
    detector = EventDetector(contract)

    def scan(*sent):
        frames = [
            Frame(at * MS, contract.message(name).can_id, bytes(contract.message(name).encode(values)))
            for at, name, values in sent
        ]
        block = decode_block(frames, contract)
        return detector.scan(block, block.stamps_ns)

    return scan


def texts(events):
    return [event.text for event in events]


def test_a_changed_state_is_an_event_and_a_lane(scan):
    scan((0, "TCU_Status", {"State": 1}))
    events, changes = scan((10, "TCU_Status", {"State": 1}), (20, "TCU_Status", {"State": 2}))
    assert texts(events) == ["TCU_Status: State TRACTION"]
    assert (events[0].time_ns, events[0].source, events[0].level) == (20 * MS, "TCU", "INFO")
    assert [(c.message, c.signal.name, c.states) for c in changes] == [("TCU_Status", "State", ("TRACTION",))]
    assert changes[0].times_ns.tolist() == [20 * MS]


def test_an_unchanged_state_is_no_event(scan):
    scan((0, "TCU_Status", {"State": 1}))
    events, changes = scan(*((10 * k, "TCU_Status", {"State": 1}) for k in range(1, 9)))
    assert events == []
    assert changes == []


def test_the_first_frame_of_a_message_tells_all_its_states_in_one_event(scan):
    events, changes = scan((5, "ATO_Heartbeat", {"NmtState": 0}))
    assert texts(events) == ["ATO_Heartbeat: first heard, NmtState BOOT_UP"]
    assert changes[0].states == ("BOOT_UP",)


def test_a_change_across_two_blocks_is_seen_once(scan):
    scan((0, "ATO_Heartbeat", {"NmtState": 0}))
    first, _ = scan((100, "ATO_Heartbeat", {"NmtState": 5}))
    second, _ = scan((200, "ATO_Heartbeat", {"NmtState": 5}))
    assert texts(first) == ["ATO_Heartbeat: NmtState OPERATIONAL"]
    assert second == []


def test_every_frame_of_an_event_message_is_an_event_with_its_values(scan):
    balise = {"Number": 3, "Position": 1234.567}
    events, _ = scan((0, "ODO_Balise", balise), (1, "ODO_Balise", balise))
    assert texts(events) == ["ODO_Balise: Number 3, Position 1234567 mm"] * 2


def test_an_emergency_message_is_an_error_until_it_is_cleared(scan):
    raised, _ = scan((0, "TCU_Emergency", {"ErrorCode": 0x8120, "Detail": -7}))
    cleared, _ = scan((5, "TCU_Emergency", {"ErrorCode": 0}))
    assert raised[0].level == "ERROR"
    assert "ErrorCode COMMAND_LOST" in raised[0].text
    assert "Detail -7" in raised[0].text
    assert cleared[0].level == "INFO"


def test_the_lockstep_handshake_is_no_event(scan):
    events, changes = scan(*((k, "SYNC", {"Tick": k}) for k in range(5)), (6, "ATO_SyncDone", {"Tick": 1}))
    assert (events, changes) == ([], [])


def test_a_silent_message_is_an_event_as_soon_as_it_is_known(scan):
    scan((0, "ODO_Motion", {}))
    events, _ = scan((49, "ATO_Position", {}))
    assert "silent" not in " ".join(texts(events))
    events, _ = scan((60, "ATO_Position", {}))
    assert texts(events) == ["ODO_Motion: silent for more than 50 ms"]
    assert (events[0].time_ns, events[0].level) == (50 * MS, "WARN")
    assert scan((70, "ATO_Position", {}))[0] == []  # said once


def test_the_end_of_a_silence_is_an_event_with_its_length(scan):
    scan((0, "ODO_Motion", {}))
    scan((100, "ATO_Position", {}))
    events, _ = scan((320, "ODO_Motion", {}))
    assert texts(events) == ["ODO_Motion: back after 320 ms"]


def test_a_silence_inside_one_block_is_told_from_both_ends(scan):
    events, _ = scan((0, "ODO_Motion", {}), (80, "ODO_Motion", {}))
    assert texts(events)[1:] == ["ODO_Motion: silent for more than 50 ms", "ODO_Motion: back after 80 ms"]


def test_a_chattering_flag_does_not_bury_the_rest(scan):
    scan((0, "ODO_Motion", {"Slip": 0}))
    events, changes = scan(*((k, "ODO_Motion", {"Slip": k % 2}) for k in range(1, 101)))
    assert len(events) == 11
    assert events[-1].text == "ODO_Motion: Slip changed 90 more times"
    assert len(changes[0].states) == 100  # the lane has them all


def test_a_count_with_one_named_value_is_no_state(contract):
    """OdometryCounter names only 15, "none": it counts, and would change in every frame."""
    assert not is_state(contract.message("ATO_Command").signal("OdometryCounter"))
    assert is_state(contract.message("ATO_Command").signal("Mode"))


def test_events_are_sorted_by_time(scan):
    events, _ = scan(
        (30, "TCU_Status", {"State": 2}), (10, "BCU_Status", {"State": 1}), (20, "ODO_Balise", {"Number": 1})
    )
    assert np.all(np.diff([event.time_ns for event in events]) >= 0)


@pytest.mark.parametrize(
    ("state", "signal", "level"),
    [
        ("NORMAL", "Supervision", "INFO"),
        ("EMERGENCY", "Mode", "ERROR"),
        ("OVERSPEED_WARNING", "Supervision", "WARN"),
        ("COMMAND_LOST", "State", "ERROR"),
        ("YES", "EmergencyApplied", "ERROR"),
        ("NO", "EmergencyApplied", "INFO"),
        ("YES", "Slip", "WARN"),
        ("YES", "DoorsClosed", "INFO"),
        ("OK_SOME_LOST", "CommandStatus", "INFO"),
        ("WRONG_CRC", "CommandStatus", "ERROR"),
    ],
)
def test_the_level_follows_the_words(state, signal, level):
    assert level_of(state, signal) == level
