"""SocketCAN's bytes: frames of 16 and 72 bytes (linux/can.h), kernel filters, ancillary data of a frame.

Pure functions; they work on every platform.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

from hil.canbus.frame import EXTENDED_ID_FLAG

__all__ = [
    "CAN_FRAME_SIZE",
    "FD_FRAME_SIZE",
    "FILTERS_AT_MOST",
    "pack_filters",
    "pack_frame",
    "parse_control",
]

CAN_FRAME_SIZE = 16
FD_FRAME_SIZE = 72
FILTERS_AT_MOST = 512
"""CAN_RAW_FILTER_MAX of linux/can/raw.h."""

REMOTE_FLAG = 0x4000_0000
ERROR_FLAG = 0x2000_0000
STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFF_FFFF

SO_TIMESTAMPNS = 35  # asm-generic/socket.h, as SO_RXQ_OVFL
SO_RXQ_OVFL = 40

HEADER = struct.Struct("=IBBBx")
"""Identifier with flags, length in bytes, flags of CAN FD, reserved."""

_CLASSIC = struct.Struct("=IB3x8s")
_FD = struct.Struct("=IBB2x64s")
_FD_FRAME, _BIT_RATE_SWITCH = 0x04, 0x01
_FD_LENGTHS = (12, 16, 20, 24, 32, 48, 64)
_FILTER = struct.Struct("=II")
_CONTROL_HEADER = struct.Struct("@Nii")  # struct cmsghdr: length with this header, level, type
_TIMESPEC = struct.Struct("@ll")
_COUNTER = struct.Struct("=I")
_ALIGNMENT = struct.calcsize("@N")
_SOL_SOCKET = 1


def pack_frame(can_id: int, data: bytes | bytearray, *, bit_rate_switch: bool = False) -> bytes:
    """A data frame as the kernel takes it: struct can_frame, above 8 data bytes struct canfd_frame.

    `can_id`: 11 bits, or 29 with `EXTENDED_ID_FLAG` (or above 0x7FF). CAN FD has no 9 data bytes, nor other
    numbers between its lengths: such data are filled up with zeros. ValueError above 64.
    """
    length = len(data)
    if can_id > STANDARD_MASK:
        can_id = EXTENDED_ID_FLAG | (can_id & EXTENDED_MASK)
    if length <= 8:
        return _CLASSIC.pack(can_id, length, bytes(data))
    if length > 64:
        raise ValueError(f"identifier {can_id & EXTENDED_MASK:#x}: {length} data bytes; 64 at most")
    whole = next(longer for longer in _FD_LENGTHS if longer >= length)
    flags = _FD_FRAME | (_BIT_RATE_SWITCH if bit_rate_switch else 0)
    return _FD.pack(can_id, whole, flags, bytes(data))


def pack_filters(wanted: Iterable[int]) -> bytes:
    """Filters (struct can_filter) for identifiers: each exactly that one, of its kind, no remote frames."""
    packed = []
    for can_id in sorted(wanted):
        mask = EXTENDED_MASK if can_id & EXTENDED_ID_FLAG else STANDARD_MASK
        packed.append(_FILTER.pack(can_id, mask | EXTENDED_ID_FLAG | REMOTE_FLAG))
    return b"".join(packed)


def parse_control(control: bytes | bytearray | memoryview) -> tuple[int, int]:
    """Time stamp [ns since the epoch] and drop counter in a frame's ancillary data; 0 for what is absent.

    The stamp is SO_TIMESTAMPNS's struct timespec. The counter is SO_RXQ_OVFL's: frames that this socket lost
    before this one; the kernel leaves it out as long as it is 0, and it wraps at 2**32.
    """
    stamp_ns = dropped = at = 0
    header_size = _CONTROL_HEADER.size
    while at + header_size <= len(control):
        length, level, kind = _CONTROL_HEADER.unpack_from(control, at)
        if length < header_size or at + length > len(control):
            break
        content = at + header_size
        if level == _SOL_SOCKET:
            if kind == SO_TIMESTAMPNS and length >= header_size + _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack_from(control, content)
                stamp_ns = seconds * 1_000_000_000 + nanoseconds
            elif kind == SO_RXQ_OVFL and length >= header_size + _COUNTER.size:
                dropped = _COUNTER.unpack_from(control, content)[0]
        at += -(-length // _ALIGNMENT) * _ALIGNMENT
    return stamp_ns, dropped
