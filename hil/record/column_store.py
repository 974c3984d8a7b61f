"""columns/: every sample of every signal, probe and timing of a run, one Parquet file for each entity.

run.rrd is for looking: of what is drawn as a line it keeps what the line needs. The numbers are here, in
full, for whatever reads Parquet. Columns: `bus_time`, `sim_time`, `cycle`, `position` (mm), then each signal
as `Speed [km/h]`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hil.record.errors import RecordingUnreadable

__all__ = ["FOLDER", "STORED", "TIME_COLUMNS", "ColumnStore", "StoredColumns"]

FOLDER = "columns"
STORED = ("/bus/", "/probe/", "/timing/")
"""Entities whose columns are stored, by the start of their path."""

TIME_COLUMNS = ("bus_time", "sim_time", "cycle", "position")
TIME_TYPES = (pa.timestamp("ns", tz="UTC"), pa.duration("ns"), pa.int64(), pa.int64())
FEW_VALUES = 0.2
"""Of the rows of a first block: with fewer distinct values, a column is stored as a dictionary of them."""

Columns = Mapping[str, pa.Array]


class ColumnStore:
    """Writes blocks of columns; memory does not grow with the run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._writers: dict[str, pq.ParquetWriter] = {}

    def write(self, entity: str, times: Sequence[NDArray[np.int64]], columns: Columns) -> None:
        """Append rows: `times` in the order of TIME_COLUMNS, each (n), as `columns` are."""
        stamps = [
            pa.array(values, pa.int64()).cast(kind) for values, kind in zip(times, TIME_TYPES, strict=True)
        ]
        table = pa.table({**dict(zip(TIME_COLUMNS, stamps, strict=True)), **columns})
        if entity not in self._writers:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._writers[entity] = self._open(entity, table)
        self._writers[entity].write_table(table)

    def close(self) -> None:
        """Finish the files."""
        for writer in self._writers.values():
            writer.close()

    def __enter__(self) -> ColumnStore:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _open(self, entity: str, table: pa.Table) -> pq.ParquetWriter:
        names = table.column_names[len(TIME_COLUMNS) :]
        rows = max(table.num_rows, 1)
        few = [name for name in names if len(table[name].unique()) < FEW_VALUES * rows]
        encodings = dict.fromkeys(TIME_COLUMNS, "DELTA_BINARY_PACKED")
        for name in names:
            if name not in few:
                floating = pa.types.is_floating(table[name].type)
                encodings[name] = "BYTE_STREAM_SPLIT" if floating else "PLAIN"
        return pq.ParquetWriter(
            self.folder / file_name(entity),
            table.schema,
            compression="zstd",
            use_dictionary=few,
            column_encoding=encodings,
        )


class StoredColumns:
    """Reads columns back, each file when it is asked for."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def has(self, entity: str) -> bool:
        """Whether this entity was stored."""
        return self._folder is not None and self._path(entity).is_file()

    def rows(self, entity: str) -> int:
        """How many rows an entity has; nothing but the end of the file is read."""
        return int(self._file(entity).metadata.num_rows)

    def names(self, entity: str) -> list[str]:
        """Its columns."""
        return [name for name in self._file(entity).schema_arrow.names if name not in TIME_COLUMNS]

    def read(self, entity: str, names: Sequence[str]) -> dict[str, NDArray[np.generic]]:
        """Columns of an entity, each (n), times in ns; rows that lack one are left out.

        Raises RecordingUnreadable.
        """
        table = self._file(entity).read(columns=list(names))
        for name in names:
            if table[name].null_count:
                table = table.filter(table[name].is_valid())
        found: dict[str, NDArray[np.generic]] = {}
        for name in names:
            column = table[name].cast(pa.int64()) if name in TIME_COLUMNS else table[name]
            found[name] = column.to_numpy()
        return found

    def _path(self, entity: str) -> Path:
        return (self._folder or Path()) / file_name(entity)

    def _file(self, entity: str) -> pq.ParquetFile:
        try:
            return pq.ParquetFile(self._path(entity))
        except (OSError, pa.ArrowException) as error:
            reason = " ".join(str(error).split())
            raise RecordingUnreadable(f"{self._path(entity)}: not a readable table: {reason}") from None


def file_name(entity: str) -> str:
    """File of an entity: bus.ODO_Motion.parquet."""
    return f"{entity.strip('/').replace('/', '.')}.parquet"
