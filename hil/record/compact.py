"""What becomes of a recording when its run has ended: run.rrd to look at, columns/ with all the numbers.

A recording is written in pieces of half a second with every sample in them, so that little is lost if the
recorder dies: 260 MB an hour. When the run has ended, the samples go into columns/ (Parquet), run.rrd keeps
of every line what drawing it needs, and the pieces are joined. Piece by piece: memory does not grow.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.chunk import Chunk, OptimizationProfile

from hil.record.charts import UNIT_SUFFIX
from hil.record.column_store import FOLDER, STORED, TIME_COLUMNS, ColumnStore
from hil.record.rrd import open_rrd
from hil.record.thinning import Thinner
from hil.record.viewer import viewer_binary

__all__ = ["THINNED", "compact", "repair"]

THINNED = "columns"
"""Property of a recording whose numbers are beside it."""

BLOCK_ROWS = 16_384
"""Rows of an entity that are thinned and stored at a time: a bit less than three minutes at 100 Hz."""

Times = list[NDArray[np.int64]]


def compact(
    recording: Path, dashboard: Callable[[], rrb.Blueprint], *, thin: bool = True, held: Collection[str] = ()
) -> None:
    """Replace a recording by its compact form under this dashboard; `thin=False` only joins its pieces.

    `held` are the signals that are drawn in steps, as `Message.Signal` or `process/probe`.
    First columns/ is complete, then the recording is replaced, each in one step: whatever happens here, no
    sample is lost.
    """
    entry = open_rrd(recording).recordings()[0]
    draft = recording.with_name(f"{recording.name}.{os.getpid()}.new")
    numbers = recording.with_name(f"{FOLDER}.{os.getpid()}.new")
    try:
        joined = rr.RecordingStream(
            entry.application_id, recording_id=entry.recording_id, send_properties=False
        )
        joined.set_sinks(rr.FileSink(draft, write_footer=True), default_blueprint=dashboard())
        stream = open_rrd(recording).stream()
        if thin:
            stream = stream.drop(content=[f"{start}**" for start in STORED])
        joined.send_chunks(stream.collect(optimize=OptimizationProfile.OBJECT_STORE))
        if thin:
            joined.send_property(THINNED, rr.AnyValues(numbers=FOLDER))
            with ColumnStore(numbers) as store:
                joined.send_chunks(list(_thinned(recording, store, held)))
        joined.disconnect()
        if numbers.is_dir():
            shutil.rmtree(recording.with_name(FOLDER), ignore_errors=True)
            os.replace(numbers, recording.with_name(FOLDER))
        os.replace(draft, recording)
    finally:
        draft.unlink(missing_ok=True)
        shutil.rmtree(numbers, ignore_errors=True)


def repair(recording: Path, repaired: Path) -> bool:
    """Copy what is whole of a recording that was cut off; False if there is nothing."""
    command = [
        str(viewer_binary()),
        "rrd",
        "optimize",
        "--continue-on-error",
        str(recording),
        "-o",
        str(repaired),
    ]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    return done.returncode == 0 and repaired.is_file() and repaired.stat().st_size > 0


@dataclass
class _Entity:
    """Rows of one entity that wait for a block, and what the columns of all blocks keep."""

    types: dict[str, pa.DataType] = field(default_factory=dict)  # of its columns, some in some pieces only
    batches: list[pa.RecordBatch] = field(default_factory=list)
    rows: int = 0
    thinners: dict[str, Thinner] = field(default_factory=dict)
    kept: dict[str, list[tuple[Times, NDArray[np.generic]]]] = field(
        default_factory=lambda: defaultdict(list)
    )


def _thinned(recording: Path, store: ColumnStore, held: Collection[str]) -> Iterator[Chunk]:
    """Store all samples of a recording; one chunk of what drawing it needs for every column."""
    entities: dict[str, _Entity] = defaultdict(_Entity)
    for chunk in _stored_chunks(recording):
        schema = chunk.to_record_batch().schema
        components = [name for name in schema.names if ":" in name and not name.startswith("rerun.")]
        for component in components:
            is_held = _quantity(component) in {UNIT_SUFFIX.sub("", name.replace("/", ".")) for name in held}
            entities[chunk.entity_path].thinners[component] = Thinner(held=is_held)
        entities[chunk.entity_path].types |= {c: schema.field(c).type.value_type for c in components}
    for chunk in _stored_chunks(recording):
        entity = entities[chunk.entity_path]
        entity.batches.append(chunk.to_record_batch())
        entity.rows += chunk.num_rows
        if entity.rows >= BLOCK_ROWS:
            _finish_block(chunk.entity_path, entity, store)
    for path, entity in entities.items():
        if entity.batches:
            _finish_block(path, entity, store)
        for component, blocks in entity.kept.items():
            times = [np.concatenate([block[0][k] for block in blocks]) for k in range(len(TIME_COLUMNS))]
            yield _chunk(path, component, times, np.concatenate([values for _, values in blocks]))


def _finish_block(path: str, entity: _Entity, store: ColumnStore) -> None:
    batches, entity.batches, entity.rows = entity.batches, [], 0
    times = [np.concatenate([_integers(b.column(name)) for b in batches]) for name in TIME_COLUMNS]
    order = np.argsort(times[0], kind="stable")
    times = [values[order] for values in times]
    columns: dict[str, pa.Array] = {}
    for component, kind in entity.types.items():
        parts = [_values(batch, component, kind) for batch in batches]
        column = pa.concat_arrays(parts).take(pa.array(order))
        columns[component.partition(":")[2]] = column
        known = np.flatnonzero(column.is_valid().to_numpy(zero_copy_only=False))
        if pa.types.is_floating(kind) and len(known):  # counters and check sums are not drawn
            values = column.drop_null().to_numpy(zero_copy_only=False)
            rows = entity.thinners[component].rows(values.astype(np.float64))
            entity.kept[component].append(([instants[known[rows]] for instants in times], values[rows]))
    store.write(path, times, columns)


def _chunk(path: str, component: str, times: Times, values: NDArray[np.generic]) -> Chunk:
    bus, sim, cycle, position = times
    group, _, name = component.partition(":")
    return Chunk.from_columns(
        path,
        indexes=[
            rr.TimeColumn("bus_time", timestamp=bus.astype("datetime64[ns]")),
            rr.TimeColumn("sim_time", duration=sim.astype("timedelta64[ns]")),
            rr.TimeColumn("cycle", sequence=cycle),
            rr.TimeColumn("position", sequence=position),
        ],
        columns=rr.DynamicArchetype.columns(archetype=group, components=_named(name, values)),
    )


def _named(name: str, values: NDArray[np.generic]) -> Mapping[str, NDArray[np.generic]]:
    return {name: values}


def _quantity(component: str) -> str:
    """`controller.speed` of `controller:speed [km/h]` and of `controller:speed_mps [m/s]`."""
    return UNIT_SUFFIX.sub("", component.replace(":", ".", 1).partition(" [")[0])


def _values(batch: pa.RecordBatch, component: str, kind: pa.DataType) -> pa.Array:
    """Values of a column of one-element lists; null in a piece that lacks it."""
    if component not in batch.schema.names:
        return pa.nulls(batch.num_rows, kind)
    return pc.list_element(batch.column(component), 0)


def _stored_chunks(recording: Path) -> Iterator[Chunk]:
    """The pieces of the entities that are stored, one at a time."""
    wanted = [f"{start}**" for start in STORED]
    yield from open_rrd(recording).stream().filter(content=wanted, is_static=False)


def _integers(column: pa.Array) -> NDArray[np.int64]:
    values: NDArray[np.int64] = column.cast(pa.int64()).to_numpy(zero_copy_only=False)
    return values
