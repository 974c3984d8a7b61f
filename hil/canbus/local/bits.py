"""Wire time of one CAN frame, exact to the bit: stuff bits of the actual bits, CRC, delimiters, end of frame.

Classic CAN and CAN FD with the ISO frame format (ISO 11898-1:2015): in CAN FD the bits up to the end of the
data are stuffed as in classic CAN, the CRC field has stuff bits at fixed places and begins with the stuff
count. Where the bit rate switches, the sample points of both rates are taken to be equal: then the switching
bits BRS and CRC delimiter together last exactly one nominal and one data bit.
"""

from __future__ import annotations

from typing import NamedTuple

INTERFRAME_BITS = 3
"""The intermission between two frames, recessive; not part of a frame."""

CLASSIC_LENGTH = 8
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Data bytes of a CAN FD frame by its data length code."""

NS_PER_S = 1_000_000_000

_END_BITS = 1 + 1 + 1 + 7  # CRC delimiter, ACK slot, ACK delimiter, end of frame
_CRC15_BITS = 15
_CRC15_POLYNOMIAL = 0x4599
_CRC15_MASK = 0x7FFF
# Stuff count (4 bits) and CRC, a fixed stuff bit before them and after each 4 bits, CRC delimiter.
_FD_CRC17_FIELD_BITS = 4 + 17 + 6 + 1
_FD_CRC21_FIELD_BITS = 4 + 21 + 7 + 1
_FD_CRC17_LENGTH = 16  # longest data with the shorter CRC
_FD_END_BITS = 1 + 1 + 7
_FD_DLC = {length: code for code, length in enumerate(FD_LENGTHS)}
_FD_PADDED = [next(fits for fits in FD_LENGTHS if fits >= length) for length in range(65)]

_RUN_LIMIT = 5
_STATES = 2 * (_RUN_LIMIT - 1)  # value of the last bit, and how many of it in a row: 1 to 4


class FrameBits(NamedTuple):
    """Bits of a frame on the wire from start of frame to end of frame, stuff bits included."""

    nominal_bits: int
    """At the nominal bit rate."""
    data_bits: int
    """At the data bit rate; 0 without bit-rate switch."""
    stuff_bits: int
    """Stuff bits among them, fixed ones of CAN FD included."""
    head_bits: int
    """Nominal bits before the first bit at the data bit rate (without a switch: all)."""

    @property
    def total(self) -> int:
        """All bits."""
        return self.nominal_bits + self.data_bits


def frame_bits(
    can_id: int,
    data: bytes | bytearray = b"",
    *,
    extended: bool = False,
    remote: bool = False,
    fd: bool = False,
    brs: bool = False,
    esi: bool = False,
    dlc: int | None = None,
) -> FrameBits:
    """Bits of a frame, without the interframe space (`INTERFRAME_BITS`).

    `can_id` without flag bits. `dlc` is the data length [bytes] that a remote frame asks for (default: that
    of `data`). CAN FD data of a length in between are padded with zeros. Raises ValueError: no such frame.
    """
    if not 0 <= can_id <= (0x1FFF_FFFF if extended else 0x7FF):
        raise ValueError(f"identifier {can_id:#x} does not fit {29 if extended else 11} bits")
    length = len(data)
    if fd:
        if remote:
            raise ValueError("CAN FD has no remote frames")
        if length > FD_LENGTHS[-1]:
            raise ValueError(f"{length} data bytes, at most {FD_LENGTHS[-1]} fit a CAN FD frame")
        return _fd_bits(can_id, data, extended=extended, brs=brs, esi=esi)
    if length > CLASSIC_LENGTH:
        raise ValueError(f"{length} data bytes, at most {CLASSIC_LENGTH} fit a classic frame")
    if remote:
        data, length = b"", 0
    code = length if dlc is None else dlc
    if not 0 <= code <= 15:
        raise ValueError(f"data length code {code} is not in 0..15")
    return _classic_bits(can_id, data, code, extended=extended, remote=remote)


def frame_duration_ns(
    can_id: int,
    data: bytes | bytearray = b"",
    *,
    bitrate: int,
    data_bitrate: int | None = None,
    extended: bool = False,
    remote: bool = False,
    fd: bool = False,
    brs: bool = False,
    esi: bool = False,
    dlc: int | None = None,
) -> int:
    """How long a frame is on the wire [ns], without the interframe space; without `data_bitrate` [bit/s] a
    switch of the bit rate changes nothing.
    """
    bits = frame_bits(can_id, data, extended=extended, remote=remote, fd=fd, brs=brs, esi=esi, dlc=dlc)
    return duration_ns(bits.nominal_bits, bits.data_bits, bitrate, data_bitrate)


def duration_ns(nominal_bits: int, data_bits: int, bitrate: int, data_bitrate: int | None = None) -> int:
    """Time of so many bits [ns], rounded to a whole one; bit rates in bit/s."""
    if not data_bits or data_bitrate is None or data_bitrate == bitrate:
        return ((nominal_bits + data_bits) * NS_PER_S + bitrate // 2) // bitrate
    both = bitrate * data_bitrate
    return ((nominal_bits * data_bitrate + data_bits * bitrate) * NS_PER_S + both // 2) // both


def worst_case_bits(length: int, *, extended: bool = False) -> int:
    """Longest classic frame with `length` data bytes, interframe space included.

    Davis, Burns, Bril, Lukkien: "Controller Area Network (CAN) schedulability analysis: refuted, revisited
    and revised", Real-Time Systems 35 (2007), equation 1. Raises ValueError beyond 8 bytes.
    """
    if not 0 <= length <= CLASSIC_LENGTH:
        raise ValueError(f"{length} data bytes are not in 0..{CLASSIC_LENGTH}")
    stuffed = (54 if extended else 34) + 8 * length
    return stuffed + 13 + (stuffed - 1) // 4


# -- one frame --------------------------------------------------------------------------------------------


def _classic_bits(
    can_id: int, data: bytes | bytearray, code: int, *, extended: bool, remote: bool
) -> FrameBits:
    # From start of frame (dominant: 0) to the data length code, as one number.
    if extended:
        head = (can_id >> 18) << 27 | 3 << 25 | (can_id & 0x3FFFF) << 7 | remote << 6 | code
        count = 39
    else:
        head = can_id << 7 | remote << 6 | code
        count = 19
    length = len(data)
    count += 8 * length
    stream = head << 8 * length | int.from_bytes(data, "big")
    # The CRC begins with 0, so zeros in front, which fill up the first byte, change nothing.
    crc = 0
    for byte in stream.to_bytes((count + 7) >> 3, "big"):
        crc = (crc << 8 & _CRC15_MASK) ^ _CRC15[crc >> 7 ^ byte]
    count += _CRC15_BITS
    stuffed = _stuff_bits(stream << _CRC15_BITS | crc, count)
    total = count + stuffed + _END_BITS
    return FrameBits(total, 0, stuffed, total)


def _fd_bits(can_id: int, data: bytes | bytearray, *, extended: bool, brs: bool, esi: bool) -> FrameBits:
    length = len(data)
    if length not in _FD_DLC:
        data = bytes(data).ljust(_FD_PADDED[length], b"\0")
        length = len(data)
    if extended:
        # Base identifier, SRR and IDE recessive, rest of the identifier, RRS 0, FDF 1, res 0, BRS.
        head = (can_id >> 18) << 24 | 3 << 22 | (can_id & 0x3FFFF) << 4 | 4 | brs
        count = 36
    else:
        head = can_id << 5 | 4 | brs  # RRS 0, IDE 0, FDF 1, res 0, BRS
        count = 17
    tail = (esi << 4 | _FD_DLC[length]) << 8 * length | int.from_bytes(data, "big")
    tail_count = 5 + 8 * length
    stuffed_head = _stuff_bits(head, count)
    # A stuff bit due after the last data bit gives way to the first fixed one: leave the last bit out.
    stuffed = _stuff_bits((head << tail_count | tail) >> 1, count + tail_count - 1)
    crc_field, fixed = (_FD_CRC17_FIELD_BITS, 6) if length <= _FD_CRC17_LENGTH else (_FD_CRC21_FIELD_BITS, 7)
    total = count + tail_count + stuffed + crc_field + _FD_END_BITS
    if not brs:
        return FrameBits(total, 0, stuffed + fixed, total)
    # Neither a run that began before BRS nor its stuff bit reaches beyond it: res is 0, BRS is 1.
    nominal_head = count + stuffed_head
    nominal = nominal_head + _FD_END_BITS
    return FrameBits(nominal, total - nominal, stuffed + fixed, nominal_head)


# -- tables -----------------------------------------------------------------------------------------------


def _stuff_bits(stream: int, count: int) -> int:
    """Stuff bits of the last `count` bits of `stream`, the first of which is 0 (start of frame)."""
    # Alternating bits in front, which end in 1, fill up the first byte: they neither need a stuff bit nor
    # begin a run with the start of frame.
    fill = -count & 7
    stream |= (0x55 & (1 << fill) - 1) << count
    state = _AFTER_FILL
    stuffed = 0
    for byte in stream.to_bytes((count + 7) >> 3, "big"):
        entry = _STUFF[state | byte]
        stuffed += entry & 15
        state = entry & ~0xFF
    return stuffed


def _step(state: int, bit: int) -> tuple[int, int]:
    """State after one more bit, and whether a stuff bit followed; state: last bit * 4 + run length - 1."""
    last, run = divmod(state, _RUN_LIMIT - 1)
    run = run + 2 if bit == last else 1
    if run == _RUN_LIMIT:
        return (1 - bit) * (_RUN_LIMIT - 1), 1  # the stuff bit begins the next run
    return bit * (_RUN_LIMIT - 1) + run - 1, 0


def _stuff_table() -> list[int]:
    """By state * 256 + byte: the next state * 256 + the number of stuff bits (at most 2 in a byte)."""
    table = []
    for start in range(_STATES):
        for byte in range(256):
            state, stuffed = start, 0
            for shift in range(7, -1, -1):
                state, more = _step(state, byte >> shift & 1)
                stuffed += more
            table.append(state << 8 | stuffed)
    return table


def _crc15_table() -> list[int]:
    """By byte: what it leaves in the CRC register."""
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = crc << 1 ^ (_CRC15_POLYNOMIAL if crc & 0x4000 else 0)
        table.append(crc & _CRC15_MASK)
    return table


_STUFF = _stuff_table()
_CRC15 = _crc15_table()
_AFTER_FILL = (_RUN_LIMIT - 1) << 8  # a 1, once: as after fill bits
