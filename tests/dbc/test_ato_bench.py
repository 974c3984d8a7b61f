"""Lint over the shipped bus contract: what a reader, a tool and a node may rely on."""

from __future__ import annotations

from itertools import combinations

import cantools
import pytest

import dbc
from hil.canbus.contract import Contract
from hil.canbus.protection import COUNTER_MODULUS, NO_COUNTER, E2EStatus

DATABASE = cantools.database.load_file(dbc.path(), database_format="dbc", strict=True)
CONTRACT = Contract.load()
MESSAGES = [pytest.param(message, id=message.name) for message in DATABASE.messages]
SIGNALS = [
    pytest.param(message, signal, id=f"{message.name}.{signal.name}")
    for message in DATABASE.messages
    for signal in message.signals
]
PROTECTED = (
    "ATO_Command", "TCU_Status", "BCU_Status", "ODO_Motion", "ODO_Balise",
    "ATP_Permission", "ATP_Restriction",
)  # fmt: skip

# function codes of CANopen's predefined connection set (CiA 301, 7.3.5) that a node may send on, and
# 0x680, which CiA 301 neither uses nor restricts
SYNC = 0x080
BASES = {
    "EMCY": 0x080,
    "TPDO1": 0x180,
    "TPDO2": 0x280,
    "TPDO3": 0x380,
    "TPDO4": 0x480,
    "free": 0x680,
    "HB": 0x700,
}


def node_number(name):
    return DATABASE.get_node_by_name(name).dbc.attributes["NodeID"].value


def signal_bits(signal):
    if signal.byte_order == "little_endian":
        return {signal.start + k for k in range(signal.length)}
    first = 8 * (signal.start // 8) + 7 - signal.start % 8
    return {8 * (p // 8) + 7 - p % 8 for p in range(first, first + signal.length)}


def crc8_j1850(data):
    """SAE J1850 polynomial 0x1D, start and final value 0, bit by bit."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1D if crc & 0x80 else crc << 1) & 0xFF
    return crc


def test_everything_in_the_file_is_supported():
    assert not CONTRACT.unsupported
    assert list(CONTRACT.messages) == [message.name for message in DATABASE.messages]


def test_identifiers_and_names_are_unique():
    assert len({message.frame_id for message in DATABASE.messages}) == len(DATABASE.messages)
    assert len({message.name for message in DATABASE.messages}) == len(DATABASE.messages)


def test_node_numbers_are_unique_and_legal():
    numbers = [node_number(node.name) for node in DATABASE.nodes]
    assert len(set(numbers)) == len(numbers)
    assert all(1 <= number <= 127 for number in numbers)


@pytest.mark.parametrize("message", MESSAGES)
def test_identifier_belongs_to_the_senders_node_number(message):
    if message.frame_id == SYNC:
        return
    number = node_number(message.senders[0])
    assert message.frame_id - number in BASES.values()
    assert not message.is_extended_frame


@pytest.mark.parametrize("message", MESSAGES)
def test_message_has_one_sender_and_is_heard_by_the_bench(message):
    assert len(message.senders) == 1
    (sender,) = message.senders
    assert sender in CONTRACT.nodes
    assert sender not in message.receivers
    if sender != "BENCH":
        for signal in message.signals:
            assert "BENCH" in signal.receivers


def test_receivers_are_those_that_evaluate_the_message():
    received = {
        node: {name for name, codec in CONTRACT.messages.items() if node in codec.receivers}
        for node in CONTRACT.nodes
    }
    inputs = {
        "TCU_Status",
        "BCU_Status",
        "ODO_Motion",
        "ODO_Balise",
        "ATP_Permission",
        "ATP_Restriction",
        "SYNC",
    }
    assert received["ATO"] == inputs
    assert received["TCU"] == {"ATO_Command", "SYNC", "ATO_SyncDone"}
    assert received["BCU"] == {"ATO_Command"}
    assert received["ATP"] == {"ATO_Command", "ODO_Motion"}
    sent_by_others = {name for name, codec in CONTRACT.messages.items() if codec.sender != "BENCH"}
    assert received["BENCH"] == sent_by_others


@pytest.mark.parametrize("message", MESSAGES)
def test_cyclic_message_has_a_cycle_and_a_longer_silence_limit(message):
    codec = CONTRACT.message(message.name)
    if codec.send_type == "cyclic":
        assert codec.cycle_ns is not None
        assert codec.timeout_ns is not None
        # a limit must outlive single lost frames
        assert codec.timeout_ns >= 3 * codec.cycle_ns
    else:
        assert codec.send_type in ("event", "sync")
        assert codec.cycle_ns is None
        assert codec.timeout_ns is None


@pytest.mark.parametrize("message", MESSAGES)
def test_comment_says_what_the_message_is(message):
    assert message.comment
    assert message.comment.rstrip().endswith(".")


@pytest.mark.parametrize(("message", "signal"), SIGNALS)
def test_comment_says_what_the_signal_is(message, signal):
    assert signal.comment
    assert signal.comment.rstrip().endswith(".")


def test_every_node_has_a_comment():
    assert all(node.comment for node in DATABASE.nodes)


@pytest.mark.parametrize("message", MESSAGES)
def test_no_bits_overlap_and_all_lie_inside_the_payload(message):
    for one, other in combinations(message.signals, 2):
        assert not signal_bits(one) & signal_bits(other), (one.name, other.name)
    used = set().union(*(signal_bits(signal) for signal in message.signals))
    assert used <= set(range(8 * message.length))


@pytest.mark.parametrize(("message", "signal"), SIGNALS)
def test_range_fits_the_bits(message, signal):
    assert signal.minimum is not None
    assert signal.maximum is not None
    assert signal.minimum < signal.maximum
    lowest = -(1 << (signal.length - 1)) if signal.is_signed else 0
    highest = lowest + (1 << signal.length) - 1
    for limit in (signal.minimum, signal.maximum):
        raw = (limit - signal.offset) / signal.scale
        assert raw == pytest.approx(round(raw), abs=1e-6), "a limit lies on a step of the signal"
        assert lowest <= round(raw) <= highest


@pytest.mark.parametrize(("message", "signal"), SIGNALS)
def test_start_value_is_given_and_inside_the_range(message, signal):
    assert signal.raw_initial is not None
    start = signal.raw_initial * signal.scale + signal.offset
    assert signal.minimum <= start <= signal.maximum
    if signal.choices and set(range(int(signal.minimum), int(signal.maximum) + 1)) == set(signal.choices):
        assert signal.raw_initial in signal.choices


@pytest.mark.parametrize(("message", "signal"), SIGNALS)
def test_value_table_fits_the_range(message, signal):
    for raw in signal.choices or {}:
        assert signal.minimum <= raw <= signal.maximum


def test_protected_are_exactly_the_safety_relevant_messages():
    assert {name for name, codec in CONTRACT.messages.items() if codec.protection} == set(PROTECTED)


@pytest.mark.parametrize("name", PROTECTED)
def test_protected_message_has_profile_1_geometry(name):
    message = DATABASE.get_message_by_name(name)
    crc, counter = message.get_signal_by_name("Crc"), message.get_signal_by_name("Counter")
    assert (crc.start, crc.length, counter.start, counter.length) == (0, 8, 8, 4)
    assert (counter.minimum, counter.maximum) == (0, COUNTER_MODULUS - 1)
    codec = CONTRACT.message(name)
    assert [(s.name, s.role) for s in codec.signals if s.role != "NONE"] == [
        ("Crc", "CRC"),
        ("Counter", "COUNTER"),
    ]
    assert codec.protection is not None
    assert codec.protection.max_delta_counter == 3


@pytest.mark.parametrize("name", PROTECTED)
def test_silence_outlasts_the_accepted_counter_gap(name):
    codec = CONTRACT.message(name)
    if codec.cycle_ns is not None:
        assert codec.timeout_ns > codec.protection.max_delta_counter * codec.cycle_ns


def test_data_ids_leave_different_marks_in_an_8_bit_crc():
    # two data IDs are 16 bits, the CRC 8: different IDs alone do not reveal a masquerade
    ids = [CONTRACT.message(name).protection.data_id for name in PROTECTED]
    marks = {crc8_j1850(data_id.to_bytes(2, "little")) for data_id in ids}
    assert len(marks) == len(ids)
    assert 0 not in marks, "a payload stuck at zero must not be valid"


def test_e2e_status_numbers_are_those_of_the_receiver():
    for name in ("TCU_Status", "BCU_Status"):
        choices = CONTRACT.message(name).signal("CommandStatus").choices
        assert choices == {status.value: status.name for status in E2EStatus}


def test_odometry_counter_can_say_that_there_is_none():
    signal = CONTRACT.message("ATO_Command").signal("OdometryCounter")
    assert signal.choices[NO_COUNTER] == "NONE"
    assert signal.start == NO_COUNTER


def test_the_same_table_has_the_same_names_everywhere():
    for first, second in [
        (("ATO_Command", "Mode"), ("ATO_Status", "Mode")),
        (("ATO_Status", "Supervision"), ("ATO_Emergency", "SupervisionState")),
        (("TCU_Emergency", "ErrorCode"), ("ATO_Emergency", "ErrorCode")),
        (("BCU_Emergency", "ErrorCode"), ("ATO_Emergency", "ErrorCode")),
    ]:
        tables = [CONTRACT.message(message).signal(signal).choices for message, signal in (first, second)]
        assert tables[0] == tables[1]
        assert tables[0]


def test_heartbeat_of_every_node():
    for node in CONTRACT.nodes:
        assert CONTRACT.message(f"{node}_Heartbeat").can_id == 0x700 + node_number(node)
        assert CONTRACT.message(f"{node}_Heartbeat").sender == node


def test_a_sender_that_knows_nothing_permits_nothing():
    start = CONTRACT.message("ATP_Permission").start_values
    assert (start["PermittedSpeed"], start["DepartureAuthorised"], start["DoorsClosed"]) == (0, 0, 0)
    assert CONTRACT.message("ODO_Motion").start_values["Valid"] == 0
    assert CONTRACT.message("ATO_Command").start_values["EffortDemand"] == 0
