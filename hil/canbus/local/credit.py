"""Local bus with a bit rate, the sender's side: how many of its frames wait for the wire."""

from __future__ import annotations

import struct

from hil.canbus.local.wire import CONTROL, HEADER, HEADER_SIZE, Control

_COUNT = struct.Struct("<Q")


class TransmitCredit:
    """Counts frames handed to the hub against those that it says were sent."""

    def __init__(self, limit_frames: int | None) -> None:
        self.limit_frames = limit_frames
        """None: without a bit rate nothing waits, and nothing is counted."""
        self._handed = 0
        self._done = 0

    @property
    def pending(self) -> int:
        """Frames not yet acknowledged on the wire."""
        return max(0, self._handed - self._done)

    def allows(self, frames: int) -> bool:
        """Whether so many more may be handed over; more than the queue holds only when it is empty."""
        pending = self.pending
        return self.limit_frames is None or not pending or pending + frames <= self.limit_frames

    def hand(self, frames: int) -> None:
        """So many were handed over."""
        self._handed += frames

    def note(self, data: bytes) -> None:
        """Take over what a SENT record says; it may be read twice."""
        if len(data) == _COUNT.size:
            self._done = max(self._done, _COUNT.unpack(data)[0])


def sent_record(done: int) -> bytes:
    """The hub tells a client how many of its frames are done: sent, or dropped when it went bus-off."""
    return HEADER.pack(0, Control.SENT, _COUNT.size, CONTROL, 0) + _COUNT.pack(done)


def count_frames(records: bytes) -> int:
    """How many frames are in `records`."""
    offset = count = 0
    while offset + HEADER_SIZE <= len(records):
        _, _, length, flags, _ = HEADER.unpack_from(records, offset)
        offset += HEADER_SIZE + length
        count += flags < CONTROL
    return count
