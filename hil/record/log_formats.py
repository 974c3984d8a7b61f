"""Frame logs in the formats of other tools: which there are, and writing them with absolute time kept.

python-can's writers do the work. Three of them lose the time of day as they are (4.6): ASC has a date with
milliseconds that are not padded, MF4 takes the time of writing for the start, TRC leaves out CAN FD without
an error. What is corrected here is the start of the file, and that a loss is counted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import can
from can.io.asc import ASCWriter

from hil.record.errors import MissingPackage, RecordError, RecordingUnreadable

__all__ = ["FRAME_FORMATS", "check_formats", "convert_log", "log_name", "read_log", "write_log"]

FRAME_FORMATS = {
    "blf": "Vector BLF: compressed, absolute time to the nanosecond",
    "asc": "Vector ASC: text, time of day in the header, microseconds after it",
    "log": "candump -L: text, epoch time to the microsecond",
    "trc": "PEAK TRC 2.1: text, start time in the header; no CAN FD",
    "mf4": "ASAM MDF 4 with bus logging; needs asammdf",
}
"""Formats of a frame log: suffix and what it is."""

BATCH = 4096


def check_formats(formats: Iterable[str]) -> tuple[str, ...]:
    """The formats without repetition. Raises RecordError for an unknown one, MissingPackage."""
    wanted = tuple(dict.fromkeys(formats))
    for name in wanted:
        if name not in FRAME_FORMATS:
            raise RecordError(f"--log {name}: not a format of frame logs; use {', '.join(FRAME_FORMATS)}")
    if "mf4" in wanted:
        need_asammdf()
    return wanted


def need_asammdf() -> None:
    """Raises MissingPackage unless asammdf is there."""
    if find_spec("asammdf") is None:
        raise MissingPackage("MF4 needs the package asammdf: pip install 'ato-hil[mf4]'")


def log_name(kind: str) -> str:
    """File name of a frame log: frames.asc."""
    return f"frames.{kind}"


def read_log(path: Path) -> Iterator[can.Message]:
    """Frames of a log in absolute time (epoch s), whatever its format. Raises RecordingUnreadable."""
    if not path.is_file():
        raise RecordingUnreadable(f"{path}: no such frame log")
    options: dict[str, Any] = {"relative_timestamp": False} if path.suffix == ".asc" else {}
    try:
        with can.LogReader(path, **options) as reader:
            yield from reader
    except Exception as error:  # readers of foreign files: they end in ValueError, struct.error and others
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordingUnreadable(f"{path}: not a readable frame log: {reason}") from None


def write_log(path: Path, kind: str, messages: Iterable[can.Message]) -> tuple[int, int]:
    """Write frames in absolute time; how many were written, and how many the format cannot hold."""
    frames = iter(messages)
    first = next(frames, None)
    written = left_out = 0
    with closing(_Stopping(_writer(path, kind, 0.0 if first is None else first.timestamp))) as log:
        while first is not None:
            if kind == "trc" and (first.is_fd or first.is_error_frame or first.is_remote_frame):
                left_out += 1
            else:
                log.writer.on_message_received(first)
                written += 1
            first = next(frames, None)
    return written, left_out


def convert_log(source: Path, folder: Path, kinds: Sequence[str]) -> dict[str, tuple[Path, int, int]]:
    """Write a frame log again in other formats; format -> file, frames written, frames left out."""
    made = {}
    for kind in kinds:
        path = folder / log_name(kind)
        if path.resolve() == source.resolve():
            raise RecordError(f"{path}: is the log to be converted; choose another directory with --out")
        made[kind] = (path, *write_log(path, kind, read_log(source)))
    return made


class _Stopping:
    """python-can's writers are stopped, not closed."""

    def __init__(self, writer: Any) -> None:
        self.writer = writer

    def close(self) -> None:
        self.writer.stop()


def _writer(path: Path, kind: str, start_s: float) -> Any:
    if kind == "asc":
        return _AscWriter(path, start_s)
    if kind == "mf4":
        return _mf4_writer(path, start_s)
    makers: dict[str, Callable[[Path], Any]] = {
        "blf": can.BLFWriter,
        "log": lambda file: can.CanutilsLogWriter(file, channel="can0"),
        "trc": can.TRCWriter,
    }
    return makers[kind](path)


class _AscWriter(ASCWriter):
    """Starts at a whole second: its header then holds the whole start, and no digit can get lost.

    The time of day is local, as CANoe writes and as readers take it.
    """

    def __init__(self, file: Path, start_s: float) -> None:
        self._begin = math.floor(start_s)
        super().__init__(file)
        date = self._format_header_datetime(datetime.fromtimestamp(self._begin))
        self.file.write(f"Begin Triggerblock {date}\n")
        self.file.write(self.FORMAT_EVENT.format(timestamp=0.0, message="Start of measurement"))
        self.started = self.last_timestamp = float(self._begin)
        self.header_written = True

    def _format_header_datetime(self, dt: datetime) -> str:
        del dt  # the time of writing, or that of the first frame
        return datetime.fromtimestamp(self._begin).strftime(self.FORMAT_DATE.format("000"))


def _mf4_writer(path: Path, start_s: float) -> Any:
    need_asammdf()
    import numpy as np
    from can.io.mf4 import STD_DTYPE, MF4Writer

    class Mf4Writer(MF4Writer):
        """Starts when the first frame came, and appends frames in batches, not one by one."""

        def __init__(self) -> None:
            super().__init__(path)
            self._mdf.header.start_time = datetime.fromtimestamp(start_s, UTC)
            # asammdf keeps whole nanoseconds of what datetime can hold: microseconds.
            self._start_time = self._mdf.header.start_time.timestamp()
            self._batch: list[can.Message] = []

        def on_message_received(self, msg: can.Message) -> None:
            if msg.is_remote_frame or msg.is_error_frame:
                super().on_message_received(msg)
                return
            self._batch.append(msg)
            if len(self._batch) >= BATCH:
                self._append()

        def stop(self) -> None:
            self._append()
            super().stop()

        def _append(self) -> None:
            messages, self._batch = self._batch, []
            if not messages:
                return
            rows = np.zeros(len(messages), dtype=STD_DTYPE)
            field = {name.rpartition(".")[2]: rows[name] for name in rows.dtype.names or ()}
            for name, values in {
                "BusChannel": [can.util.channel2int(m.channel) or 0 for m in messages],
                "ID": [m.arbitration_id for m in messages],
                "IDE": [m.is_extended_id for m in messages],
                "Dir": [not m.is_rx for m in messages],
                "DataLength": [len(m.data) for m in messages],
                "DLC": [can.util.len2dlc(m.dlc) for m in messages],
                "ESI": [m.is_fd and m.error_state_indicator for m in messages],
                "BRS": [m.is_fd and m.bitrate_switch for m in messages],
                "EDL": [m.is_fd for m in messages],
            }.items():
                field[name][:] = values
            width = field["DataBytes"].shape[1]
            joined = b"".join(bytes(m.data).ljust(width, b"\0") for m in messages)
            field["DataBytes"][:] = np.frombuffer(joined, np.uint8).reshape(len(messages), width)
            times = np.array([m.timestamp for m in messages]) - self._start_time
            self._mdf.extend(0, [(times, None), (rows, None)])

    return Mf4Writer()
