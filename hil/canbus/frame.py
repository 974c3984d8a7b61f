"""A data frame as the nodes see it: when, which identifier, what bytes."""

from __future__ import annotations

from typing import NamedTuple

EXTENDED_ID_FLAG = 0x8000_0000
"""Set in `Frame.can_id` of a frame with a 29-bit identifier (CAN_EFF_FLAG of linux/can.h)."""


class Frame(NamedTuple):
    """One received data frame, classic or CAN FD.

    `timestamp_ns` is CLOCK_REALTIME in ns since the epoch, stamped by the interface. `can_id` is the
    11-bit identifier, or the 29-bit identifier plus `EXTENDED_ID_FLAG`. `data` has 0..64 bytes.
    """

    timestamp_ns: int
    can_id: int
    data: bytes
