"""Decoded signals as files: CSV and Parquet on one time base or per message, MF4 with units and states."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from hil.record.errors import RecordError
from hil.record.log_formats import need_asammdf
from hil.record.run_data import Column, RunData

__all__ = ["TABLE_FORMATS", "grid", "group_names", "write_measurement", "write_tables"]

TABLE_FORMATS = {"csv": "decoded signals as text", "parquet": "decoded signals for pandas, polars, DuckDB"}

NS_PER_S = 1_000_000_000


def group_names(run: RunData, signals: Sequence[str] = ()) -> dict[str, list[str]]:
    """Message or process -> its signals that have samples, of those asked for (default: all)."""
    counts = {info.name: info.samples for info in run.signals}
    names = [run[name].name for name in signals] if signals else list(run)
    groups: dict[str, list[str]] = {}
    for name in names:
        if counts[name]:
            groups.setdefault(name.partition(".")[0], []).append(name)
    return groups


def grid(run: RunData) -> str | np.ndarray[Any, np.dtype[np.float64]]:
    """The time base of a wide table: the cycles of the first process, or every 10 ms without any."""
    for process in run.processes:
        if run.rows(f"/timing/{process}"):
            return f"{process}.wakeup_latency_us"
    duration_s = max((float(run[name].sim_time_s[-1]) for name in run if len(run[name])), default=0.0)
    return np.arange(0.0, duration_s, 0.01)


def write_tables(
    run: RunData, folder: Path, kind: str, *, per_message: bool, signals: Sequence[str] = ()
) -> list[Path]:
    """One wide table signals.csv on the cycle grid, or one table per message at its own stamps."""
    groups = group_names(run, signals)
    if not groups:
        raise RecordError(f"{run.path}: no samples to export")
    if not per_message:
        names = [name for those in groups.values() for name in those]
        path = folder / f"signals.{kind}"
        _write(_with_units(run.to_arrow(names, on=grid(run)), run), path, kind)
        return [path]
    made = []
    for group, names in groups.items():
        path = folder / f"{group}.{kind}"  # timing and probes of a process have the same stamps
        _write(_with_units(run.to_arrow(names), run), path, kind)
        made.append(path)
    return made


def write_measurement(run: RunData, path: Path, signals: Sequence[str] = ()) -> int:
    """signals.mf4: a channel group for each message and process, channels with unit; how many channels.

    A state is stored as its number with a table of its names. Raises MissingPackage without asammdf.
    """
    need_asammdf()
    from asammdf import MDF, Signal

    start_ns = run.start_ns // 1000 * 1000  # datetime holds microseconds
    count = 0
    with MDF(version="4.10") as file:
        file.header.start_time = datetime.fromtimestamp(start_ns // NS_PER_S, UTC).replace(
            microsecond=start_ns % NS_PER_S // 1000
        )
        for group, names in group_names(run, signals).items():
            columns = [run[name] for name in names]
            seconds = (columns[0].bus_time_ns - start_ns) / NS_PER_S
            channels = [
                Signal(
                    samples=column.values if not column.choices else column.values.astype(np.int64),
                    timestamps=seconds,
                    name=column.name,
                    unit=column.unit,
                    conversion=_words(column),
                )
                for column in columns
            ]
            file.append(channels, acq_name=group, comment=group, common_timebase=True)
            count += len(channels)
        file.save(path, overwrite=True, compression=2)
    return count


def _words(column: Column) -> dict[str, Any] | None:
    if not column.choices:
        return None
    table: dict[str, Any] = {}
    for row, (value, word) in enumerate(column.choices.items()):
        table |= {f"val_{row}": value, f"text_{row}": word.encode()}
    return {**table, "default": b""}


def _with_units(table: pa.Table, run: RunData) -> pa.Table:
    names = [
        f"{name} [{run[name].unit}]" if name in run and run[name].unit else name
        for name in table.column_names
    ]
    return table.rename_columns(names)


def _write(table: pa.Table, path: Path, kind: str) -> None:
    if kind == "parquet":
        pq.write_table(table, path, compression="zstd")
    else:
        pa_csv.write_csv(table, path)
