"""The recorder: frames and cycles in, run.rrd and frames.blf out. Knows the contract, no train and no law.

Frames are collected and written in blocks, a few a second: decoding and writing columns costs a
microsecond or two a frame, doing it frame by frame would cost a hundred.
"""

from __future__ import annotations

import json
import time
import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.record.blocks import decode_block
from hil.record.compact import compact
from hil.record.dashboard import CHARTS, POSITION, Chart
from hil.record.errors import RecordError
from hil.record.frame_log import FrameLog
from hil.record.log_formats import check_formats, convert_log, log_name
from hil.record.pages import Pages
from hil.record.rerun_sink import RerunSink
from hil.record.rings import RingFeed
from hil.record.timelines import LockstepTime, RealTime, RecordingTime

__all__ = ["FRAME_LOG", "RECORDING", "Recorder", "RecorderOptions", "RecordingStats", "RingStats"]

RECORDING, FRAME_LOG = "run.rrd", "frames.blf"
BLOCK_INTERVAL_S = 0.5
MOST_FRAMES_PER_BLOCK = 20_000


@dataclass(frozen=True)
class RecorderOptions:
    """What to record and where.

    `tick_ns` is needed in lockstep only. `rings` are the nodes' timing rings by process name; the first
    one counts the cycles. `start_ns` (epoch) is the time of tick 0 in lockstep, now if None. `position`
    names the signal of the timeline of that name. `viewer_url`: a live viewer to send to as well. `logs`:
    formats in which the frame log is written again at the end (log_formats.FRAME_FORMATS). `thin`: all
    numbers go to columns/ and run.rrd keeps what is drawn; else run.rrd keeps them.
    """

    directory: Path
    clock: str = "realtime"
    tick_ns: int | None = None
    rings: Mapping[str, Path] = field(default_factory=dict)
    properties: Mapping[str, Any] = field(default_factory=dict)
    position: str = POSITION
    charts: Sequence[Chart] = CHARTS
    start_ns: int | None = None
    viewer_url: str | None = None
    logs: Sequence[str] = ()
    thin: bool = True


@dataclass(frozen=True)
class RingStats:
    """Cycles of one process: recorded, and lost because they were overwritten before they were read."""

    records: int
    lost: int


@dataclass(frozen=True)
class RecordingStats:
    """What was recorded. `dropped` and `error_frames` are what the bus interface says; sizes in bytes."""

    frames: int
    frames_by_message: Mapping[str, int]
    unknown_frames: int
    malformed_frames: int
    dropped: int
    error_frames: int
    counter_lost: Mapping[str, int]
    counter_repeated: Mapping[str, int]
    events: int
    rings: Mapping[str, RingStats]
    duration_s: float
    bytes: Mapping[str, int] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


class Recorder:
    """Records one run. Feed it frames, poll it often, close it. A context manager.

    Usable without a bus, in the process that drives a run in lockstep. Raises RecordError when the
    directory cannot be written or the options make no sense.
    """

    def __init__(self, contract: Contract, options: RecorderOptions) -> None:
        self.options = options
        self.contract = contract
        recording_time = _recording_time(contract, options)
        self._formats = check_formats(options.logs)
        try:
            options.directory.mkdir(parents=True, exist_ok=True)
            self._log = FrameLog(options.directory / FRAME_LOG)
        except OSError as error:
            raise RecordError(
                f"{options.directory}: cannot record there: {error.strerror or error}"
            ) from None
        self._pending: list[Frame] = []
        self._rings = [RingFeed(name, path) for name, path in options.rings.items()]
        self._unknown: Counter[int] = Counter()
        self._malformed: Counter[str] = Counter()
        self._stats: RecordingStats | None = None
        self._flushed = time.monotonic()
        self._pages = Pages(
            contract,
            recording_time,
            lambda blueprint: RerunSink(
                options.directory / RECORDING,
                recording_id=f"{options.directory.resolve().name}-{uuid.uuid4().hex[:8]}",
                name=str(options.properties.get("name") or options.directory.resolve().name),
                blueprint=blueprint,
                viewer_url=options.viewer_url,
            ),
            charts=options.charts,
            position=options.position,
            processes=tuple(options.rings),
            properties=options.properties,
            lockstep=options.clock == "lockstep",
        )
        self._pages.describe(options.properties)

    def feed(self, frames: Sequence[Frame]) -> None:
        """Take frames in the order of arrival. Cheap: the work is done in `poll`."""
        self._pending.extend(frames)

    def poll(self) -> None:
        """Write a block if it is time. Call this every few ten milliseconds."""
        now = time.monotonic()
        if now - self._flushed >= BLOCK_INTERVAL_S or len(self._pending) >= MOST_FRAMES_PER_BLOCK:
            self.flush()

    def count(self, *, dropped: int, error_frames: int) -> None:
        """Say what the bus interface has counted so far."""
        self._pages.interface_counters = {"dropped": dropped, "error frames": error_frames}

    def flush(self) -> None:
        """Write everything that waits."""
        self._flushed = time.monotonic()
        frames, self._pending = self._pending, []
        block = decode_block(frames, self.contract)
        self._unknown.update(block.unknown)
        self._malformed.update(block.malformed)
        cycles = [(ring, cycles) for ring in self._rings if (cycles := ring.read()) is not None]
        times_ns = self._pages.write(block, cycles, frames)
        self._log.write(frames, times_ns.tolist())

    def close(self, *, dropped: int = 0, error_frames: int = 0) -> RecordingStats:
        """Write what waits, finish the files, say what was recorded. Once; later calls repeat the answer."""
        if self._stats is not None:
            return self._stats
        self.flush()
        heard = self._pages.statistics.heard
        stats = RecordingStats(
            frames=self._log.frames,
            frames_by_message={name: count.frames for name, count in heard.items() if count.frames},
            unknown_frames=self._unknown.total(),
            malformed_frames=self._malformed.total(),
            dropped=dropped,
            error_frames=error_frames,
            counter_lost={name: count.lost for name, count in heard.items() if count.lost},
            counter_repeated={name: count.repeated for name, count in heard.items() if count.repeated},
            events=self._pages.events,
            rings={ring.name: RingStats(ring.records, ring.lost) for ring in self._rings},
            duration_s=self._pages.duration_s,
        )
        self._pages.close({key: value for key, value in stats.as_dict().items() if key != "bytes"})
        self._log.close()
        for ring in self._rings:
            ring.close()
        series = [series for chart in self.options.charts for series in chart.series]
        compact(
            self.options.directory / RECORDING,
            self._pages.dashboard,
            thin=self.options.thin,
            held={source for those in series if those.step for source in those.sources},
        )
        others = [kind for kind in self._formats if log_name(kind) != FRAME_LOG]
        convert_log(self.options.directory / FRAME_LOG, self.options.directory, others)
        files = (self.options.directory / name for name in (RECORDING, FRAME_LOG))
        self._stats = replace(stats, bytes={path.name: path.stat().st_size for path in files})
        return self._stats

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def read_properties(path: Path) -> dict[str, Any]:
    """Properties of a run from a JSON file. Raises RecordError."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise RecordError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(content, dict):
        raise RecordError(f"{path}: expected a JSON object with the run's properties")
    return content


def _recording_time(contract: Contract, options: RecorderOptions) -> RecordingTime:
    if options.clock == "realtime":
        return RealTime()
    if options.clock != "lockstep":
        raise RecordError(f"clock {options.clock!r} is not known; use realtime or lockstep")
    if options.tick_ns is None:
        raise RecordError("a recording in lockstep needs the tick (tick_ns, --tick-s)")
    start_ns = time.time_ns() if options.start_ns is None else options.start_ns
    return LockstepTime(contract, start_ns, options.tick_ns)
