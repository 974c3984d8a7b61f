"""Reading a run back: signals, probes, timing, events and properties of a recording, by name.

A recording carries its DBC and its column tables, so nothing else is needed. It is read once, as a whole;
columns are put together when asked for. Files without a footer (the recorder was killed) are read too.
"""

from __future__ import annotations

import json
import tempfile
import warnings
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from rerun.chunk import Chunk, RrdReader

from hil.record.column_store import FOLDER, StoredColumns
from hil.record.compact import THINNED, repair
from hil.record.cycle_pages import TIMING_GROUP
from hil.record.errors import NotRecorded, RecordError, RecordingUnreadable
from hil.record.recorder import RECORDING
from hil.record.rerun_sink import component_name, with_unit
from hil.record.rings import TIMING_COLUMNS
from hil.record.rrd import open_rrd

__all__ = ["MessageColumns", "Run", "RunEvent", "open_run"]

TEXT, LEVEL = "TextLog:text", "TextLog:level"
ROW_ID, ROW_ID_BYTES = "rerun.controls.RowId", 16
NS_PER_S = 1e9
MM_PER_M = 1e3

Array = NDArray[np.float64]
TIMELINES = {"sim_time": NS_PER_S, "bus_time": NS_PER_S, "cycle": 1.0, "position": MM_PER_M}
"""Timelines and what their integers are divided by: s, s since the epoch, cycles, m."""


@dataclass(frozen=True)
class MessageColumns:
    """A message of the contract: its identifier, sender, and name -> unit of its signals."""

    name: str
    can_id: int
    sender: str
    signals: Mapping[str, str]


@dataclass(frozen=True)
class RunEvent:
    """A line of the event log: s since the start, INFO/WARN/ERROR, the node, the text."""

    time_s: float
    level: str
    source: str
    text: str


@dataclass(frozen=True)
class Run:
    """A recorded run. Every look-up raises NotRecorded (a KeyError) with the names that there are.

    `warning` is empty, or says in one line what is wrong with the file; what could be read is there.
    """

    path: Path
    warning: str
    chunks: Mapping[str, Sequence[Chunk]]

    def signal(self, name: str, *, timeline: str = "sim_time") -> tuple[Array, Array]:
        """Places on a timeline and values of `Message.Signal`, both (n); values in the DBC's unit.

        The places are s since the start; see TIMELINES for the others. Empty when never received.
        """
        message, _, signal = name.partition(".")
        signals = self._pick(self._tables, message, "message")["signals"]
        unit = self._pick(signals, signal, f"signal of {message}")
        return self._column(f"/bus/{message}", component_name(message, with_unit(signal, unit)), timeline)

    def probe(self, process: str, name: str, *, timeline: str = "sim_time") -> tuple[Array, Array]:
        """Places on a timeline and values of a process's inner value, in the probe's unit."""
        unit = self._pick(self.probes(process), name, f"probe of {process}")
        return self._column(f"/probe/{process}", component_name(process, with_unit(name, unit)), timeline)

    def probes(self, process: str) -> dict[str, str]:
        """Name -> unit of the probes of a process."""
        return dict(self._pick(self._processes, process, "process")["probes"])

    def timing(self, process: str) -> dict[str, Array]:
        """Timing of every cycle of a process, arrays of one length.

        Keys: `time_s` and `cycle` of the schedule; `wakeup_latency_us`, `read_us`, `step_us`, `encode_us`,
        `send_us`, their sum without the latency `execution_us`, `period_error_us`, and `missed`, whole cycles
        skipped since the process started.
        """
        self._pick(self._processes, process, "process")
        timing: dict[str, Array] = {}
        for name, unit in TIMING_COLUMNS:
            key = f"{name}_us" if unit == "us" else name
            component = component_name(TIMING_GROUP, with_unit(name, unit))
            timing["time_s"], timing[key] = self._column(f"/timing/{process}", component, "sim_time")
        timing["cycle"] = self._column(f"/timing/{process}", component, "cycle")[0]
        timing["execution_us"] = timing["read_us"] + timing["step_us"] + timing["send_us"]
        if len(timing["encode_us"]) == len(timing["send_us"]):  # older recordings count it as sending
            timing["execution_us"] += timing["encode_us"]
        return timing

    def events(self) -> list[RunEvent]:
        """All events by time."""
        found = []
        for entity in self.chunks:
            if entity.startswith("/events/"):
                for batch in self._batches(entity, TEXT):
                    times = _integers(batch.column("sim_time")) / NS_PER_S
                    texts, levels = (pc.list_flatten(batch.column(c)).to_pylist() for c in (TEXT, LEVEL))
                    source = entity.removeprefix("/events/")
                    found += [
                        RunEvent(float(time), level, source, text)
                        for time, level, text in zip(times, levels, texts, strict=True)
                    ]
        return sorted(found, key=lambda event: event.time_s)

    @cached_property
    def messages(self) -> dict[str, MessageColumns]:
        """The messages of the contract that this run was recorded with."""
        return {
            name: MessageColumns(name, table["can_id"], table["sender"], table["signals"])
            for name, table in self._tables.items()
        }

    @property
    def processes(self) -> tuple[str, ...]:
        """The processes whose cycles were recorded."""
        return tuple(self._processes)

    @cached_property
    def properties(self) -> dict[str, Any]:
        """The run's properties as they were given to the recorder."""
        return self._json("run")

    @cached_property
    def recording(self) -> dict[str, Any]:
        """What the recorder counted; empty when it was killed."""
        return self._json("recording")

    @cached_property
    def dbc(self) -> str:
        """Text of the DBC that this run was recorded with."""
        return str(self._property("contract", "dbc") or "")

    @cached_property
    def _tables(self) -> dict[str, Any]:
        return dict(json.loads(self._property("contract", "messages") or "{}"))

    @cached_property
    def _processes(self) -> dict[str, Any]:
        start = "/__properties/process_"
        names = [entity.removeprefix(start) for entity in self.chunks if entity.startswith(start)]
        return {name: self._json(f"process_{name}") for name in sorted(names)}

    def _json(self, name: str) -> dict[str, Any]:
        return dict(json.loads(self._property(name, "json") or "{}"))

    def _property(self, name: str, key: str) -> Any:
        value = None
        for chunk in self.chunks.get(f"/__properties/{name}", ()):
            batch = chunk.to_record_batch()
            for column in batch.schema.names:
                if column == key or column.endswith(f":{key}"):
                    value = batch.column(column)[-1].as_py()
        return value[0] if isinstance(value, list) and value else value

    def integer_columns(
        self, entity: str, component: str, timelines: Sequence[str] = ("bus_time", "sim_time")
    ) -> tuple[list[NDArray[np.int64]], Array]:
        """Places on some timelines and values of a column, each (n), in the order of the first timeline.

        Times are in ns, `bus_time` since the epoch; `position` in mm. From columns/ if it is there.
        """
        store, name = self.stored, component.partition(":")[2]
        if store.has(entity):
            if name not in store.names(entity):
                return [np.empty(0, np.int64) for _ in timelines], np.empty(0)
            columns = store.read(entity, [*timelines, name])
            places = [columns[timeline].astype(np.int64) for timeline in timelines]
            order = np.argsort(places[0], kind="stable")
            return [known[order] for known in places], columns[name].astype(np.float64)[order]
        batches = list(self._batches(entity, component))
        if not batches:
            return [np.empty(0, np.int64) for _ in timelines], np.empty(0)
        places = [np.concatenate([_integers(b.column(timeline)) for b in batches]) for timeline in timelines]
        values = np.concatenate([_values(batch.column(component)) for batch in batches])
        rows = np.concatenate([_row_numbers(batch) for batch in batches])
        order = np.lexsort((rows[:, 1], rows[:, 0], places[0]))  # of one instant in the order of the bus
        return [known[order] for known in places], values[order]

    def rows(self, entity: str) -> int:
        """How many rows an entity has."""
        if self.stored.has(entity):
            return self.stored.rows(entity)
        return sum(chunk.num_rows for chunk in self.chunks.get(entity, ()) if not chunk.is_static)

    @cached_property
    def stored(self) -> StoredColumns:
        """The numbers beside the recording; none if it carries them itself."""
        thinned = f"/__properties/{THINNED}" in self.chunks
        return StoredColumns(self.path.parent / FOLDER if thinned else None)

    def _column(self, entity: str, component: str, timeline: str) -> tuple[Array, Array]:
        """Places and values of a column, both (n), in the order of the timeline."""
        if timeline not in TIMELINES:
            raise RecordError(f"timeline {timeline!r} is not known; use one of {', '.join(TIMELINES)}")
        (places,), values = self.integer_columns(entity, component, (timeline,))
        return places / TIMELINES[timeline], values

    def _batches(self, entity: str, column: str) -> Iterator[pa.RecordBatch]:
        """The temporal parts of an entity that have this column."""
        for chunk in self.chunks.get(entity, ()):
            if not chunk.is_static:
                batch = chunk.to_record_batch()
                if column in batch.schema.names:
                    yield batch

    def _pick(self, table: Mapping[str, Any], name: str, kind: str) -> Any:
        if name not in table:
            known = ", ".join(table) or "none"
            raise NotRecorded(f"{self.path}: no {kind} {name!r} in this recording; it has {known}")
        return table[name]


def open_run(path: Path | str) -> Run:
    """Open a run directory or an .rrd file. Raises RecordingUnreadable."""
    file = Path(path)
    if file.is_dir():
        file /= RECORDING
    if not file.is_file():
        raise RecordingUnreadable(f"{path}: no recording there (expected a run directory with {RECORDING})")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a missing footer is told in `Run.warning`
        try:
            chunks, finished = _read(file)
            warning = (
                "" if finished else f"{file}: the recorder did not finish this file; its end may be missing"
            )
        except Exception as error:  # the reader's errors have no common class
            chunks = _read_whole_parts(file, _one_line(error))
            warning = f"{file}: this file is cut off, its end is missing"
    if not any(entity.startswith("/__properties/contract") for entity in chunks):
        raise RecordingUnreadable(f"{file}: no recording of a run (it does not carry its DBC)")
    if f"/__properties/{THINNED}" in chunks and not (file.parent / FOLDER).is_dir():
        warning = warning or f"{file}: {FOLDER}/ is not beside it: only the samples that are drawn are there"
    return Run(file, warning, chunks)


def _read(file: Path) -> tuple[dict[str, list[Chunk]], bool]:
    """All chunks of a file by entity, and whether it was finished."""
    chunks: dict[str, list[Chunk]] = defaultdict(list)
    reader = open_rrd(file)
    if reader.recordings():
        for chunk in reader.stream():
            chunks[chunk.entity_path].append(chunk)
    return dict(chunks), _finished(reader)


def _read_whole_parts(file: Path, reason: str) -> dict[str, list[Chunk]]:
    """What is whole in a file that was cut inside a part: the reader itself refuses such a file."""
    with tempfile.TemporaryDirectory() as scratch:
        repaired = Path(scratch) / "repaired.rrd"
        if not repair(file, repaired):
            raise RecordingUnreadable(f"{file}: not a readable recording: {reason}")
        return _read(repaired)[0]


def _finished(reader: RrdReader) -> bool:
    try:
        reader.store()
    except Exception:  # no footer, or a damaged one
        return False
    return True


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _integers(column: pa.Array) -> NDArray[np.int64]:
    values: NDArray[np.int64] = column.cast(pa.int64()).to_numpy(zero_copy_only=False)
    return values


def _values(column: pa.Array) -> Array:
    values: Array = pc.list_flatten(column).to_numpy(zero_copy_only=False).astype(np.float64, copy=False)
    return values


def _row_numbers(batch: pa.RecordBatch) -> NDArray[np.uint64]:
    """Numbers (n, 2), high and low half, that grow in the order in which rows were written."""
    column = batch.column(ROW_ID)
    start = column.offset * ROW_ID_BYTES
    data = column.buffers()[1][start : start + len(column) * ROW_ID_BYTES]
    return np.frombuffer(data, ">u8").reshape(-1, 2).astype(np.uint64)
