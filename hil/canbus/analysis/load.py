"""Bus load of frames that were there: how long each was on the wire, per message and in the worst window.

Every frame counts with its exact length: the stuff bits of its bits, and the interframe space.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from hil.canbus.analysis.message_set import priority
from hil.canbus.local.bits import INTERFRAME_BITS, duration_ns, frame_bits

NS_PER_S = 1_000_000_000
WINDOWS_NS = (10_000_000, 100_000_000)
"""Windows in which the largest load is looked for."""


class WireFrame(NamedTuple):
    """A frame as it was on the wire; `timestamp_ns` is its end, where the bus models a bit rate."""

    timestamp_ns: int
    can_id: int
    data: bytes
    extended: bool = False
    remote: bool = False
    fd: bool = False
    brs: bool = False
    esi: bool = False
    dlc: int | None = None


@dataclass
class MessageLoad:
    """What one identifier put on the bus: frames, bits (interframe space included), ns on the wire."""

    can_id: int
    extended: bool
    frames: int = 0
    bits: int = 0
    wire_ns: int = 0


@dataclass
class Window:
    """The largest load of any window of `length_ns`: a fraction of it, and where the window ends."""

    length_ns: int
    load: float = 0.0
    end_ns: int = 0
    _inside: deque[tuple[int, int]] = field(default_factory=deque, repr=False)
    _sum_ns: int = 0

    def add(self, timestamp_ns: int, wire_ns: int) -> None:
        """Take in a frame, in the order of time."""
        self._inside.append((timestamp_ns, wire_ns))
        self._sum_ns += wire_ns
        while self._inside[0][0] <= timestamp_ns - self.length_ns:
            self._sum_ns -= self._inside.popleft()[1]
        first_end_ns, first_ns = self._inside[0]
        before_ns = max(0, timestamp_ns - self.length_ns - (first_end_ns - first_ns))
        load = (self._sum_ns - before_ns) / self.length_ns
        if load > self.load:
            self.load, self.end_ns = load, timestamp_ns


class LoadMeter:
    """Adds up frames in the order of time. Bit rates in bit/s.

    `errors` counts error frames: their length is not in a log, so they add no load.
    """

    def __init__(
        self, bitrate: int, data_bitrate: int | None = None, windows_ns: Sequence[int] = WINDOWS_NS
    ) -> None:
        self.bitrate = bitrate
        self.data_bitrate = data_bitrate
        self.messages: dict[tuple[int, bool], MessageLoad] = {}
        self.windows = [Window(length) for length in windows_ns]
        self.frames = 0
        self.errors = 0
        self.wire_ns = 0
        self.first_ns: int | None = None
        self.last_ns = 0

    def add_all(self, frames: Iterable[WireFrame]) -> None:
        """Add frames. ValueError: a frame that CAN does not have."""
        for frame in frames:
            self.add(frame)

    def add(self, frame: WireFrame) -> None:
        """Add a frame. ValueError: a frame that CAN does not have."""
        time_ns, can_id, data, extended, remote, fd, brs, esi, dlc = frame
        bits = frame_bits(
            can_id,
            data,
            extended=extended,
            remote=remote,
            fd=fd,
            brs=brs,
            esi=esi,
            dlc=dlc if remote else None,
        )
        nominal = bits.nominal_bits + INTERFRAME_BITS
        wire_ns = duration_ns(nominal, bits.data_bits, self.bitrate, self.data_bitrate)
        message = self.messages.get((can_id, extended))
        if message is None:
            message = self.messages[(can_id, extended)] = MessageLoad(can_id, extended)
        message.frames += 1
        message.bits += nominal + bits.data_bits
        message.wire_ns += wire_ns
        self.frames += 1
        self.wire_ns += wire_ns
        if self.first_ns is None:
            self.first_ns = time_ns - wire_ns
        self.last_ns = max(self.last_ns, time_ns)
        for window in self.windows:
            window.add(time_ns, wire_ns)

    @property
    def span_ns(self) -> int:
        """From the start of the first frame to the end of the last."""
        return 0 if self.first_ns is None else max(0, self.last_ns - self.first_ns)

    def by_load(self) -> list[MessageLoad]:
        """The messages, the largest load first."""
        return sorted(self.messages.values(), key=lambda m: (-m.wire_ns, priority(m.can_id, m.extended)))
