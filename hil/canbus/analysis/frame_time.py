"""How many bits a frame takes on the wire, at worst and at best, interframe space included.

Classic CAN: R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien, "Controller Area Network (CAN) schedulability
analysis: Refuted, revisited and revised", Real-Time Systems 35 (2007), equation 1. CAN FD: the fields of
ISO 11898-1:2015; a stuff bit per four bits up to the end of the data, fixed stuff bits in the CRC field.
"""

from __future__ import annotations

from dataclasses import dataclass

NS_PER_S = 1_000_000_000
INTERFRAME_BITS = 3

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Bytes that a CAN FD frame can hold; what lies between is filled up to the next."""

MAX_CLASSIC_LENGTH = 8

_STUFFED_HEAD = {False: 34, True: 54}  # SOF, identifier, control field and CRC: exposed to bit stuffing
_TAIL_BITS = 13  # CRC delimiter, ACK, ACK delimiter, end of frame (7), interframe space (3)

_FD_NOMINAL_HEAD = {False: 17, True: 36}  # SOF up to and with BRS: the bits before the data bit rate
_FD_DATA_HEAD = 5  # ESI and DLC
_FD_CRC_FIELD = {17: 4 + 17 + 6 + 1, 21: 4 + 21 + 7 + 1}  # stuff count, CRC, fixed stuff bits, CRC delimiter
_FD_TAIL_BITS = 12  # ACK, ACK delimiter, end of frame (7), interframe space (3)
_FD_CRC_17_LENGTH = 16  # bytes of data up to which the CRC has 17 bits


@dataclass(frozen=True)
class WireBits:
    """Bits at the nominal bit rate (interframe space included) and at the data bit rate of CAN FD."""

    nominal: int
    data: int = 0

    def duration_ns(self, bitrate: int, data_bitrate: int | None = None) -> int:
        """Time on the wire [ns], rounded up: a bound stays a bound."""
        fast = data_bitrate or bitrate
        return -(-NS_PER_S * (self.nominal * fast + self.data * bitrate) // (bitrate * fast))


def worst_bits(length: int, *, extended: bool = False, fd: bool = False) -> WireBits:
    """The most bits a data frame of `length` bytes can take. ValueError: no frame has this length.

    >>> worst_bits(8), worst_bits(8, extended=True)
    (WireBits(nominal=135, data=0), WireBits(nominal=160, data=0))
    """
    return _bits(length, extended, fd, stuffed=True)


def best_bits(length: int, *, extended: bool = False, fd: bool = False) -> WireBits:
    """The fewest: no stuff bit is needed. ValueError: no frame has this length."""
    return _bits(length, extended, fd, stuffed=False)


def _bits(length: int, extended: bool, fd: bool, *, stuffed: bool) -> WireBits:
    if not 0 <= length <= (FD_LENGTHS[-1] if fd else MAX_CLASSIC_LENGTH):
        kind = "CAN FD" if fd else "classic CAN"
        raise ValueError(f"{length} bytes: no {kind} frame has this length")
    if not fd:
        exposed = _STUFFED_HEAD[extended] + 8 * length
        return WireBits(exposed + _TAIL_BITS + (_most_stuff_bits(exposed) if stuffed else 0))
    carried = next(size for size in FD_LENGTHS if size >= length)
    head = _FD_NOMINAL_HEAD[extended]
    fast = _FD_DATA_HEAD + 8 * carried
    crc = _FD_CRC_FIELD[17 if carried <= _FD_CRC_17_LENGTH else 21]
    if not stuffed:
        return WireBits(head + _FD_TAIL_BITS, fast + crc)
    # As many of the stuff bits as possible where a bit takes longer.
    slow_stuff = _most_stuff_bits(head)
    return WireBits(
        head + slow_stuff + _FD_TAIL_BITS, fast + crc + _most_stuff_bits(head + fast) - slow_stuff
    )


def _most_stuff_bits(exposed: int) -> int:
    """The first after five equal bits, then one after every four: a stuff bit starts the next row of five."""
    return (exposed - 1) // 4
