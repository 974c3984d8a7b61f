"""frames.blf: every frame as it was on the bus, with absolute time, for any CAN tool."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import can
from can.io.blf import BLFWriter

from hil.canbus.frame import EXTENDED_ID_FLAG, Frame

__all__ = ["FrameLog"]

NS_PER_S = 1e9
CLASSIC_LENGTH = 8
CONTAINER_BYTES = 32 * 1024
SYNC_INTERVAL_S = 1.0


class FrameLog:
    """Writes frames with python-can's BLFWriter, in the order given.

    The file's header, which holds the absolute start time, is only complete when a BLFWriter is closed. So
    the writer is closed and appended to once a second: what a killed recorder leaves is whole up to then.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.frames = 0
        self._writer: BLFWriter | None = _writer(path, append=False)
        self._message = can.Message(is_extended_id=False)
        self._synced = time.monotonic()

    def write(self, frames: Sequence[Frame], times_ns: Sequence[int]) -> None:
        """Append frames; `times_ns` are their epoch times."""
        if self._writer is None:
            self._writer = _writer(self.path, append=True)
        write = self._writer.on_message_received
        message = self._message  # one for all: making a can.Message costs more than writing it
        for (_, can_id, data), time_ns in zip(frames, times_ns, strict=True):
            message.timestamp = time_ns / NS_PER_S
            message.arbitration_id = can_id & ~EXTENDED_ID_FLAG
            message.is_extended_id = can_id >= EXTENDED_ID_FLAG
            message.data = data  # type: ignore[assignment]  # the writer only reads it
            message.dlc = len(data)
            message.is_fd = len(data) > CLASSIC_LENGTH
            write(message)
        self.frames += len(frames)
        if frames and time.monotonic() - self._synced > SYNC_INTERVAL_S:
            self.sync()

    def sync(self) -> None:
        """Make the file whole: everything so far is on disk, under a complete header."""
        if self._writer is not None and self.frames:
            self._writer.stop()
            self._writer = None
        self._synced = time.monotonic()

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            self._writer.stop()
            self._writer = None

    def __enter__(self) -> FrameLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _writer(path: Path, *, append: bool) -> BLFWriter:
    writer = BLFWriter(path, append=append)
    writer.max_container_size = CONTAINER_BYTES
    return writer
