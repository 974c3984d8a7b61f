"""A second, plain computation of frames on the wire: lists of bits, one after the other.

ISO 11898-1:2015 (frame formats, bit stuffing, CRC) word by word, and nothing in common with
`hil.canbus.local.bits`: no tables, no numbers of many bits, and the CRC field of CAN FD is really built.
"""

from __future__ import annotations

import pytest

CRC15 = [1, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 0, 1]  # x15 + x14 + x10 + x8 + x7 + x4 + x3 + 1
CRC17 = [int(digit) for digit in f"{0x3685B:018b}"]
CRC21 = [int(digit) for digit in f"{0x302899:022b}"]
DLC = {12: 9, 16: 10, 20: 11, 24: 12, 32: 13, 48: 14, 64: 15}


def number(value, width):
    """A number as bits, the most significant first."""
    return [int(digit) for digit in f"{value:0{width}b}"]


def remainder(bits, polynomial, start):
    """CRC by long division, bit by bit; `start` is what the register holds before."""
    width = len(polynomial) - 1
    divisor = int("".join(map(str, polynomial)), 2)
    register = start
    for bit in bits:
        register = (register << 1) ^ (bit << width)
        if register >> width:
            register ^= divisor
    return number(register, width)


def stuffed(bits):
    """Bits with a complement after each five equal ones, and which of them are such stuff bits."""
    out, marks = [], []
    last, run = None, 0
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        out.append(bit)
        marks.append(False)
        if run == 5:
            last, run = 1 - bit, 1
            out.append(last)
            marks.append(True)
    return out, marks


def classic(can_id, data, *, extended=False, remote=False, dlc=None):
    """All bits of a classic frame from start of frame to end of frame."""
    code = len(data) if dlc is None else dlc
    if extended:
        bits = [0, *number(can_id >> 18, 11), 1, 1, *number(can_id & 0x3FFFF, 18), int(remote), 0, 0]
    else:
        bits = [0, *number(can_id, 11), int(remote), 0, 0]
    bits += number(code, 4)
    if not remote:
        for byte in data:
            bits += number(byte, 8)
    bits += remainder(bits, CRC15, 0)
    return stuffed(bits)[0] + [1] + [0] + [1] + [1] * 7


def fd(can_id, data, *, extended=False, brs=False, esi=False):
    """(bits before the first one at the data bit rate, those at it, those after it) of a CAN FD frame."""
    length = len(data)
    bits = [0, *number(can_id >> 18, 11)] if extended else [0, *number(can_id, 11)]
    if extended:
        bits += [1, 1, *number(can_id & 0x3FFFF, 18)]
        bits += [0, 1, 0, int(brs)]  # RRS, FDF, res, BRS
    else:
        bits += [0, 0, 1, 0, int(brs)]  # RRS, IDE, FDF, res, BRS
    switch = len(bits)
    bits += [int(esi), *number(DLC.get(length, length), 4)]
    for byte in data:
        bits += number(byte, 8)
    out, marks = stuffed(bits)
    if marks[-1]:
        out, marks = out[:-1], marks[:-1]  # the fixed stuff bit stands in its place
    count = sum(marks) % 8
    gray = count ^ count >> 1
    field = [*number(gray, 3), sum(number(gray, 3)) % 2]
    polynomial = CRC17 if length <= 16 else CRC21
    field += remainder(out + field, polynomial, 1 << (len(polynomial) - 2))
    tail = []
    for place, bit in enumerate(field):
        if place % 4 == 0:
            tail.append(1 - (tail or out)[-1])
        tail.append(bit)
    # Where is the bit that follows BRS? After as many bits as were there, and their stuff bits.
    place = plain = 0
    while plain < switch:
        plain += not marks[place]
        place += 1
    return out[:place], [*out[place:], *tail, 1], [0, 1] + [1] * 7


class Plain:
    """The plain computation, for tests of other modules."""

    classic = staticmethod(classic)
    fd = staticmethod(fd)


@pytest.fixture(scope="session")
def plain():
    """Frames as lists of bits: `classic(…)` and `fd(…)`."""
    return Plain
