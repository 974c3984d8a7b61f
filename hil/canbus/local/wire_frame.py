"""A frame on its way to the wire, what may become of it, and what decides arbitration."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, NamedTuple

from hil.canbus.local.bits import CLASSIC_LENGTH, FrameBits, frame_bits
from hil.canbus.local.confinement import Notice
from hil.canbus.local.wire import BRS, ESI, EXTENDED, EXTENDED_MASK, FD, REMOTE, STANDARD_MASK


class WireFrame(NamedTuple):
    """A frame to be sent; `can_id` with SocketCAN's flag bits, `flags` those of `wire` (FD, BRS, ESI)."""

    can_id: int
    data: bytes | bytearray = b""
    flags: int = 0
    dlc: int | None = None
    """Data length [bytes] that a remote frame asks for."""
    tag: Any = None
    """Whatever the sender wants to find again."""


class Completed(NamedTuple):
    """A frame that was sent and acknowledged."""

    end_of_frame_ns: int
    sender: Hashable
    frame: WireFrame


class Dropped(NamedTuple):
    """A frame that is not sent any more: its node went bus-off."""

    time_ns: int
    sender: Hashable
    frame: WireFrame


class Reported(NamedTuple):
    """What the controller of a node reports of an error or of its state."""

    time_ns: int
    node: Hashable
    notice: Notice


Event = Completed | Dropped | Reported


def arbitration_field(can_id: int) -> int:
    """What decides arbitration, as a number of 32 bits: the lowest wins. `can_id` with flag bits.

    Base identifier, RTR or SRR, IDE, rest of the identifier, RTR: of equal base identifiers the standard
    frame wins over the extended one, of equal identifiers the data frame over the remote one.
    """
    remote = 1 if can_id & REMOTE else 0
    if can_id & EXTENDED:
        identifier = can_id & EXTENDED_MASK
        return identifier >> 18 << 21 | 3 << 19 | (identifier & 0x3FFFF) << 1 | remote
    return (can_id & STANDARD_MASK) << 21 | remote << 20


def bits_of(frame: WireFrame) -> FrameBits:
    """Bits of a frame on the wire; ValueError: it is none."""
    can_id, data, flags, dlc, _ = frame
    extended = bool(can_id & EXTENDED)
    return frame_bits(
        can_id & (EXTENDED_MASK if extended else STANDARD_MASK),
        data,
        extended=extended,
        remote=bool(can_id & REMOTE),
        fd=bool(flags & FD) or len(data) > CLASSIC_LENGTH,
        brs=bool(flags & BRS),
        esi=bool(flags & ESI),
        dlc=dlc if can_id & REMOTE else None,
    )
