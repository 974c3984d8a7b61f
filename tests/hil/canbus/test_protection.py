"""E2E protection: what is found, and what a receiver does about it."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.canbus.contract import Contract, ContractError
from hil.canbus.protection import FAULT_LIMIT, NO_COUNTER, E2EStatus, Protector, Receiver
from hil.canbus.signals import ProtectionSpec

SPEC = ProtectionSpec("P01", 0xA184, 3)
CONTRACT = Contract.load()
PROTECTED = [pytest.param(codec, id=codec.name) for codec in CONTRACT.messages.values() if codec.protection]


def crc8_j1850(data, start=0x00, final=0x00):
    """CRC-8 SAE J1850 (polynomial 0x1D), bit by bit; AUTOSAR profile 1 uses start and final value 0."""
    crc = start
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1D if crc & 0x80 else crc << 1) & 0xFF
    return crc ^ final


def frames(count, spec=SPEC, payload=bytes(8), protector=None):
    """`count` consecutive protected messages with the same content."""
    protector = protector or Protector(spec)
    result = []
    for _ in range(count):
        data = bytearray(payload)
        protector.protect(data)
        result.append(bytes(data))
    return result


def started(count=1, spec=SPEC):
    """A receiver that has accepted `count` messages, and the messages that follow."""
    stream = frames(count + 40, spec)
    receiver = Receiver(spec, length=8)
    for data in stream[:count]:
        receiver.check(data)
    return receiver, stream[count:]


# --- the CRC ---------------------------------------------------------------------------------------------


def test_independent_crc_has_the_check_value_of_sae_j1850():
    assert crc8_j1850(b"123456789", start=0xFF, final=0xFF) == 0x4B


@pytest.mark.parametrize("seed", range(20))
def test_crc_equals_an_independent_bitwise_crc(seed):
    rng = random.Random(seed)
    spec = ProtectionSpec("P01", rng.randrange(0x10000), 3)
    payload = bytes([0, rng.randrange(16) << 4]) + rng.randbytes(rng.choice((0, 4, 6, 30, 62)))
    data = frames(rng.randrange(1, 30), spec, payload)[-1]
    assert data[0] == crc8_j1850(spec.data_id.to_bytes(2, "little") + data[1:])
    assert data[2:] == payload[2:]


def test_published_vector_of_profile_1():
    # AUTOSAR FO PRS E2EProtocol, protocol examples of profile 1: data ID 0x123, both bytes, all zero
    (data,) = frames(1, ProtectionSpec("P01", 0x123, 3))
    assert data == bytes.fromhex("cc00000000000000")


def test_counter_runs_from_0_to_14_and_wraps():
    assert [data[1] & 0x0F for data in frames(32)] == [*range(15), *range(15), 0, 1]


def test_high_nibble_of_the_counter_byte_belongs_to_the_message():
    assert {data[1] >> 4 for data in frames(16, payload=b"\x00\xa7" + bytes(6))} == {0xA}


@pytest.mark.parametrize("codec", PROTECTED)
@pytest.mark.parametrize("seed", range(4))
def test_every_corrupted_bit_is_rejected(codec, seed):
    rng = random.Random(seed)
    payload = (
        bytes(codec.length)
        if seed == 0
        else bytes([0, rng.randrange(16) << 4]) + rng.randbytes(codec.length - 2)
    )
    (good,) = frames(1, codec.protection, payload)
    for bit in range(8 * codec.length):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        receiver = Receiver(codec.protection, length=codec.length)
        assert receiver.check(bytes(bad)) is E2EStatus.WRONG_CRC, bit
        assert (receiver.ok, receiver.rejected, receiver.counter) == (0, 1, NO_COUNTER)
    assert receiver.check(good) is E2EStatus.INITIAL


@pytest.mark.parametrize("codec", PROTECTED)
def test_burst_of_up_to_eight_bits_is_rejected(codec):
    # inside the content: with the CRC in the first byte, a burst across its end is no burst to the polynomial
    (good,) = frames(1, codec.protection, b"\x00\x50" + bytes(range(codec.length - 2)))
    whole = int.from_bytes(good, "big")
    receiver = Receiver(codec.protection, length=codec.length)
    for pattern in range(1, 256):
        for shift in range(8 * (codec.length - 1) - 7):
            bad = (whole ^ pattern << shift).to_bytes(codec.length, "big")
            assert receiver.check(bad) is E2EStatus.WRONG_CRC


@pytest.mark.parametrize("codec", PROTECTED)
def test_message_of_another_data_id_is_rejected(codec):
    for other in CONTRACT.messages.values():
        if other.protection and other is not codec:
            (data,) = frames(1, other.protection, bytes(codec.length))
            receiver = Receiver(codec.protection, length=codec.length)
            assert receiver.check(data) is E2EStatus.WRONG_CRC


@pytest.mark.parametrize("codec", PROTECTED)
@pytest.mark.parametrize("stuck", [0x00, 0xFF])
def test_stuck_payload_is_rejected(codec, stuck):
    receiver = Receiver(codec.protection, length=codec.length)
    assert receiver.check(bytes([stuck] * codec.length)) is E2EStatus.WRONG_CRC


@pytest.mark.parametrize("length", [0, 1, 2, 7, 9, 64])
def test_wrong_length_is_rejected_and_leaves_the_receiver_working(length):
    receiver, following = started()
    assert receiver.check(bytes(length)) is E2EStatus.WRONG_CRC
    assert receiver.check(following[0]) is E2EStatus.OK


def test_counter_15_is_never_valid():
    data = bytearray(8)
    data[1] = 0x0F
    data[0] = crc8_j1850(SPEC.data_id.to_bytes(2, "little") + data[1:])
    assert Receiver(SPEC, length=8).check(bytes(data)) is E2EStatus.WRONG_CRC


# --- the counter -----------------------------------------------------------------------------------------


def test_before_the_first_message_there_is_no_data():
    receiver = Receiver(SPEC, length=8)
    assert receiver.status is E2EStatus.NO_NEW_DATA
    assert receiver.counter == NO_COUNTER


def test_first_good_message_is_initial_with_any_counter():
    for data in frames(15):
        receiver = Receiver(SPEC, length=8)
        assert receiver.check(data) is E2EStatus.INITIAL
        assert receiver.counter == data[1] & 0x0F
        assert receiver.lost == 0


def test_consecutive_messages_are_ok_across_the_wrap():
    receiver, following = started()
    assert {receiver.check(data) for data in following} == {E2EStatus.OK}
    assert (receiver.ok, receiver.rejected, receiver.lost) == (41, 0, 0)


def test_replayed_counter_is_rejected():
    receiver, following = started()
    assert receiver.check(following[0]) is E2EStatus.OK
    assert receiver.check(following[0]) is E2EStatus.REPEATED
    assert (receiver.ok, receiver.rejected, receiver.lost) == (2, 1, 0)
    assert receiver.check(following[1]) is E2EStatus.OK


@pytest.mark.parametrize("start", range(15))
@pytest.mark.parametrize("delta", range(2, 15))
def test_gap_is_accepted_up_to_the_largest_delta_only(start, delta):
    receiver, following = started(start + 1)
    status = receiver.check(following[delta - 1])
    accepted = delta <= SPEC.max_delta_counter
    assert status is (E2EStatus.OK_SOME_LOST if accepted else E2EStatus.WRONG_SEQUENCE)
    assert receiver.lost == delta - 1
    assert receiver.rejected == (0 if accepted else 1)
    assert receiver.counter == (start + (delta if accepted else 0)) % 15


@pytest.mark.parametrize("largest", [1, 2, 14])
def test_largest_delta_is_that_of_the_contract(largest):
    spec = ProtectionSpec("P01", 0xA184, largest)
    for delta in range(1, 15):
        receiver, following = started(1, spec)
        assert Receiver.accepted(receiver.check(following[delta - 1])) == (delta <= largest)


def test_receiver_resynchronises_after_a_wrong_sequence():
    receiver, following = started()
    assert receiver.check(following[6]) is E2EStatus.WRONG_SEQUENCE
    assert receiver.check(following[7]) is E2EStatus.OK
    assert receiver.counter == following[7][1] & 0x0F


def test_restarted_sender_costs_one_message():
    receiver, _ = started(8)
    restarted = frames(3)
    assert [receiver.check(data) for data in restarted] == [
        E2EStatus.WRONG_SEQUENCE,
        E2EStatus.OK,
        E2EStatus.OK,
    ]


def test_late_message_out_of_order_is_rejected():
    receiver, following = started()
    assert receiver.check(following[1]) is E2EStatus.OK_SOME_LOST
    assert receiver.check(following[0]) is E2EStatus.WRONG_SEQUENCE


def test_corrupted_message_does_not_move_the_counter():
    receiver, following = started()
    assert receiver.check(b"\xff" + following[0][1:]) is E2EStatus.WRONG_CRC
    assert receiver.counter == 0
    assert receiver.check(following[0]) is E2EStatus.OK


def test_no_new_data_changes_the_status_only():
    receiver, following = started(3)
    receiver.no_new_data()
    assert receiver.status is E2EStatus.NO_NEW_DATA
    assert (receiver.ok, receiver.rejected, receiver.counter, receiver.fault_counter) == (3, 0, 2, 0)
    assert receiver.check(following[0]) is E2EStatus.OK


def test_accepted_are_ok_some_lost_and_initial():
    accepted = {status for status in E2EStatus if Receiver.accepted(status)}
    assert accepted == {E2EStatus.OK, E2EStatus.OK_SOME_LOST, E2EStatus.INITIAL}


# --- the fault counter -----------------------------------------------------------------------------------


def test_one_bad_message_is_no_fault_five_are():
    receiver, _ = started()
    for bad in range(1, 10):
        receiver.check(bytes(8))
        assert receiver.fault_counter == min(bad, FAULT_LIMIT)
        assert receiver.faulty == (bad >= FAULT_LIMIT)


def test_fault_counter_saturates_so_that_recovery_takes_no_longer_than_the_fault():
    receiver, following = started()
    for _ in range(100):
        receiver.check(bytes(8))
    counters = []
    for data in following[:6]:
        receiver.check(data)
        counters.append(receiver.fault_counter)
    assert counters == [4, 3, 2, 1, 0, 0]
    assert not receiver.faulty


@given(st.lists(st.sampled_from(["send", "lose", "repeat", "corrupt", "swap"]), max_size=60))
def test_whatever_the_bus_does_only_newer_good_messages_are_taken(faults):
    protector, receiver, checked, last = Protector(SPEC), Receiver(SPEC, length=8), 0, None
    taken = []
    for number, fault in enumerate(faults):
        data = bytearray(8)
        data[2:4] = number.to_bytes(2, "little")
        protector.protect(data)
        arriving = {
            "send": [bytes(data)],
            "lose": [],
            "repeat": [bytes(data), bytes(data)],
            "corrupt": [bytes([data[0] ^ 0x10]) + data[1:]],
            "swap": [bytes(data)] + ([last] if last else []),
        }[fault]
        last = bytes(data)
        for frame in arriving:
            checked += 1
            faults_before = receiver.fault_counter
            status = receiver.check(frame)
            assert status is receiver.status
            if Receiver.accepted(status):
                taken.append(int.from_bytes(frame[2:4], "little"))
                assert receiver.counter == frame[1] & 0x0F
                assert receiver.fault_counter == max(faults_before - 1, 0)
            else:
                assert receiver.fault_counter == min(faults_before + 1, FAULT_LIMIT)
    assert receiver.ok + receiver.rejected == checked
    assert len(taken) == receiver.ok
    if "swap" not in faults:
        assert taken == sorted(set(taken))


# --- the specification -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("profile", "data_id", "largest", "names"),
    [
        ("P02", 1, 3, "P02"),
        ("P01", 0x10000, 3, "65536"),
        ("P01", 1, 0, "E2EMaxDeltaCounter 0"),
        ("P01", 1, 15, "15"),
    ],
)
def test_impossible_protection_is_an_error(profile, data_id, largest, names):
    with pytest.raises(ContractError, match=names):
        ProtectionSpec(profile, data_id, largest)
