"""Bits of a frame on the wire: against a plain computation, and against known numbers."""

import random

import pytest

from hil.canbus.local.bits import (
    FD_LENGTHS,
    INTERFRAME_BITS,
    frame_bits,
    frame_duration_ns,
    worst_case_bits,
)

MANY = 100_000


def some_data(rng, length):
    """Random bytes; often such that many bits in a row are equal."""
    kind = rng.randrange(4)
    if kind == 0:
        return bytes([rng.choice([0x00, 0xFF, 0x0F, 0x3C, 0x78, 0xC1, 0xE1, 0x1F])]) * length
    if kind == 1:
        return bytes(rng.choice([0x00, 0xFF, 0x1F, 0x0F, 0xF8]) for _ in range(length))
    return rng.randbytes(length)


def some_identifier(rng, *, extended):
    bits = 29 if extended else 11
    return rng.choice(
        [0, (1 << bits) - 1, rng.getrandbits(bits), rng.getrandbits(bits) & rng.getrandbits(bits)]
    )


def test_classic_frames_have_the_bits_of_a_plain_computation(plain):
    rng = random.Random(11898)
    for number in range(MANY * 6 // 10):
        extended, remote = rng.random() < 0.5, rng.random() < 0.1
        can_id = some_identifier(rng, extended=extended)
        data = b"" if remote else some_data(rng, rng.randrange(9))
        dlc = rng.randrange(9) if remote else None
        bits = frame_bits(can_id, data, extended=extended, remote=remote, dlc=dlc)
        expected = plain.classic(can_id, data, extended=extended, remote=remote, dlc=dlc)
        assert (bits.nominal_bits, bits.data_bits) == (len(expected), 0), (number, hex(can_id), data.hex())


def test_can_fd_frames_have_the_bits_of_a_plain_computation(plain):
    rng = random.Random(2015)
    for number in range(MANY * 4 // 10):
        extended, brs, esi = (rng.random() < 0.5 for _ in range(3))
        can_id = some_identifier(rng, extended=extended)
        data = some_data(rng, rng.choice(FD_LENGTHS if number % 8 == 0 else FD_LENGTHS[:12]))
        bits = frame_bits(can_id, data, extended=extended, fd=True, brs=brs, esi=esi)
        head, middle, tail = plain.fd(can_id, data, extended=extended, brs=brs, esi=esi)
        expected = (len(head) + len(tail), len(middle)) if brs else (len(head) + len(middle) + len(tail), 0)
        assert (bits.nominal_bits, bits.data_bits) == expected, (number, hex(can_id), data.hex())
        if brs:
            assert bits.head_bits == len(head)


# 47 + 8 n and 67 + 8 n bits with interframe space, as in linux/can/length.h and can-utils.
@pytest.mark.parametrize(("extended", "without_stuff_bits"), [(False, 47), (True, 67)])
def test_lengths_without_stuff_bits_are_those_of_the_linux_kernel(extended, without_stuff_bits):
    rng = random.Random(1)
    for length in range(9):
        data = rng.randbytes(length)
        bits = frame_bits(rng.getrandbits(29 if extended else 11), data, extended=extended)
        assert bits.total - bits.stuff_bits + INTERFRAME_BITS == without_stuff_bits + 8 * length


@pytest.mark.parametrize(
    ("extended", "length", "bits"), [(False, 0, 55), (False, 8, 135), (True, 0, 80), (True, 8, 160)]
)
def test_worst_case_is_that_of_davis_and_others(extended, length, bits):
    assert worst_case_bits(length, extended=extended) == bits


def test_no_frame_is_longer_than_the_worst_case_and_some_come_close():
    rng = random.Random(7)
    closest = {}
    for _ in range(20_000):
        extended, length = rng.random() < 0.5, rng.randrange(9)
        data = some_data(rng, length)
        can_id = some_identifier(rng, extended=extended)
        bits = frame_bits(can_id, data, extended=extended).total + INTERFRAME_BITS
        room = worst_case_bits(length, extended=extended) - bits
        assert room >= 0
        closest[extended, length] = min(room, closest.get((extended, length), 99))
    assert max(closest.values()) <= 8


def test_bits_written_out_by_hand():
    # Identifier 0, no data: 19 zeros and the CRC of zeros, 15 zeros: 34 bits. The first stuff bit comes after
    # five of them, then the stuff bit (1) ends each run: 6 in all. 10 more bits end the frame.
    assert frame_bits(0, b"").total == 34 + 6 + 10
    # CAN FD: 14 zeros to IDE (2 stuff bits), FDF, 7 zeros to the data length code (1 stuff bit); stuff count
    # and CRC with 6 fixed stuff bits and the delimiter are 28 bits; acknowledgement and end of frame 9.
    assert frame_bits(0, b"", fd=True).total == 14 + 2 + 1 + 7 + 1 + 28 + 9


@pytest.mark.parametrize(
    ("bitrate", "data_bitrate"), [(500_000, 2_000_000), (125_000, 8_000_000), (83_333, None)]
)
def test_duration_is_the_sum_of_the_bits_at_their_rates(bitrate, data_bitrate):
    bits = frame_bits(0x123, bytes(range(32)), fd=True, brs=True)
    exact = bits.nominal_bits / bitrate + bits.data_bits / (data_bitrate or bitrate)
    duration_ns = frame_duration_ns(
        0x123, bytes(range(32)), fd=True, brs=True, bitrate=bitrate, data_bitrate=data_bitrate
    )
    assert duration_ns == pytest.approx(exact * 1e9, abs=0.51)


def test_can_fd_data_of_a_length_in_between_are_padded():
    assert frame_bits(1, b"\1" * 9, fd=True) == frame_bits(1, b"\1" * 9 + bytes(3), fd=True)


@pytest.mark.parametrize(
    ("arguments", "options", "reason"),
    [
        ((0x800, b""), {}, "does not fit 11 bits"),
        ((1 << 29, b""), {"extended": True}, "does not fit 29 bits"),
        ((1, bytes(9)), {}, "at most 8"),
        ((1, bytes(65)), {"fd": True}, "at most 64"),
        ((1, b""), {"fd": True, "remote": True}, "no remote frames"),
    ],
)
def test_what_is_no_frame_is_refused(arguments, options, reason):
    with pytest.raises(ValueError, match=reason):
        frame_bits(*arguments, **options)
