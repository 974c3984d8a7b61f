"""How busy the bus is: bits of every tenth of a second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hil.canbus.frame import EXTENDED_ID_FLAG, Frame
from hil.canbus.local.bits import INTERFRAME_BITS, frame_bits
from hil.record.blocks import Block

__all__ = ["WINDOW_NS", "BusLoad"]

WINDOW_NS = 100_000_000
CLASSIC_LENGTH = 8
Array = NDArray[np.float64]
Times = NDArray[np.int64]


class BusLoad:
    """Counts bits, windows of 100 ms after each other; the last, unfinished one waits for the next block.

    Bits include the stuff bits and the interframe space. Stuff bits depend on the data; they are counted on
    one frame of every message in every block, and taken for all of that message there. `bitrate` is None
    where it is not known; then there is no load in percent. A CAN FD frame counts as without bit-rate switch.
    """

    def __init__(self, bitrate: int | None = None) -> None:
        self._bitrate = bitrate
        self._window: int | None = None  # number of the first window that is not told yet
        self.peaks: dict[str, float] = {}
        self._bits: Array = np.zeros(0)

    def take(
        self, frames: Sequence[Frame], block: Block, times_ns: Times
    ) -> tuple[Times, Mapping[str, Array]]:
        """Ends (epoch ns) of the windows that are over now, and their load by column name."""
        if not len(times_ns):
            return np.empty(0, np.int64), {}
        bits = np.zeros(len(block))
        for message in block.messages.values():
            bits[message.rows] = _bits(frames[int(message.rows[0])])
        slots = times_ns // WINDOW_NS
        if self._window is None:
            self._window = int(slots[0]) + 1  # nobody knows what was there before the first frame
        whole = slots >= self._window
        if not np.any(whole):
            return np.empty(0, np.int64), {}
        bits, slots = bits[whole], slots[whole]
        places = slots - self._window
        size = max(int(places.max()) + 1, len(self._bits))
        totals: Array = np.bincount(places, bits, size).astype(np.float64)
        totals[: len(self._bits)] += self._bits
        over = size - 1
        self._bits = totals[over:]
        ends = (self._window + 1 + np.arange(over, dtype=np.int64)) * WINDOW_NS
        self._window += over
        return ends, self._columns(totals[:over])

    def _columns(self, bits: Array) -> dict[str, Array]:
        windows_per_s = 1e9 / WINDOW_NS
        columns = {"rate [kbit/s]": bits * windows_per_s / 1e3}
        if self._bitrate:
            columns["load [%]"] = 100.0 * bits * windows_per_s / self._bitrate
        for name, values in columns.items():
            if len(values):
                self.peaks[name] = max(self.peaks.get(name, 0.0), float(values.max()))
        return columns


def _bits(frame: Frame) -> int:
    extended = frame.can_id >= EXTENDED_ID_FLAG
    identifier = frame.can_id & ~EXTENDED_ID_FLAG
    fd = len(frame.data) > CLASSIC_LENGTH
    return frame_bits(identifier, frame.data, extended=extended, fd=fd).total + INTERFRAME_BITS
