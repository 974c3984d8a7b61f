"""Ask a recording for numbers: columns by signal name, with their stamps, as arrays or tables.

    run = open_run("runs/20260101-120000-cat_linh_la_thanh")
    speed = run["ODO_Motion.Speed"]          # a Column: values, sim_time_s, bus_time_ns, unit
    frame = run.to_pandas(["ODO_Motion.Speed", "plant_sim.speed_mps"])

Signals are `Message.Signal`; a process's inner values (its probes, the plant's true speed among them) and its
timing are `process.name`.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import can
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hil.record import reader
from hil.record.cycle_pages import TIMING_GROUP
from hil.record.errors import MissingPackage, NotRecorded, RecordingUnreadable
from hil.record.log_formats import FRAME_FORMATS, read_log
from hil.record.reader import Array, Run
from hil.record.recorder import FRAME_LOG, RECORDING
from hil.record.rerun_sink import component_name, with_unit
from hil.record.rings import TIMING_COLUMNS

__all__ = ["Column", "RunData", "SignalInfo", "open_run"]

NS_PER_S = 1e9
Stamps = NDArray[np.int64]


@dataclass(frozen=True)
class Column:
    """n samples of one quantity in the order of time.

    `bus_time_ns` (n) is epoch time, `sim_time_s` (n) s since the start of the recording, `values` (n) in
    `unit`. `choices` names the values of a state.
    """

    name: str
    unit: str
    bus_time_ns: Stamps
    sim_time_s: Array
    values: Array
    choices: Mapping[int, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype, copy=copy)

    def held_at(self, bus_time_ns: Stamps) -> Array:
        """The latest value known at each time (m); not-a-number before the first."""
        if not len(self.values):
            return np.full(len(bus_time_ns), np.nan)
        latest = np.searchsorted(self.bus_time_ns, bus_time_ns, side="right") - 1
        return np.where(latest >= 0, self.values[np.maximum(latest, 0)], np.nan)

    def names(self) -> list[str]:
        """The values of a state as words; numbers where there is no word."""
        return [self.choices.get(int(value), f"{value:g}") for value in self.values]

    def to_arrow(self) -> pa.Table:
        """A table with `bus_time`, `sim_time` and the values under the name of the column."""
        return pa.table({**_time_arrays(self.bus_time_ns, self.sim_time_s), self.name: self.values})

    def to_pandas(self) -> Any:
        """A pandas Series over `sim_time`. Raises MissingPackage."""
        pandas = _pandas()
        index = pandas.Index(self.sim_time_s, name="sim_time")
        return pandas.Series(self.values, index=index, name=self.name)


@dataclass(frozen=True)
class SignalInfo:
    """A quantity that a recording can hold, and how many samples of it there are."""

    name: str
    unit: str
    samples: int


@dataclass(frozen=True)
class RunData(Run):
    """A recorded run, by name. Nothing is decoded before it is asked for; then it is kept.

    Unknown names raise NotRecorded (a KeyError) with the nearest ones that there are.
    """

    def __getitem__(self, name: str) -> Column:
        """All samples of `Message.Signal` or `process.name` (`process/name` too)."""
        if name not in self._cache:
            self._cache[name] = self._load(name)
        return self._cache[name]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name.replace("/", ".", 1) in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    @cached_property
    def signals(self) -> tuple[SignalInfo, ...]:
        """Everything that can be asked for, with unit and number of samples; never received: 0."""
        counts = {entity: self.rows(entity) for entity in {place[0] for place in self._places.values()}}
        return tuple(
            SignalInfo(name, unit, counts[entity]) for name, (entity, _, unit) in self._places.items()
        )

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The run's summary.json: verdict, criteria, timing; empty for a recording without one."""
        path = self.path.parent / "summary.json"
        try:
            return dict(json.loads(path.read_text(encoding="utf-8")))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise RecordingUnreadable(f"{path}: cannot be read: {error}") from None

    @property
    def frames(self) -> Iterator[can.Message]:
        """Every frame as it was on the bus, one by one, from the log beside the recording."""
        log = self.path if self.path.suffix != ".rrd" else self.path.parent / FRAME_LOG
        return read_log(log)

    def cycles(self, process: str) -> pa.Table:
        """Every cycle of a process: times, cycle, its timing (us) and its probes, one column each."""
        timing = self.timing(process)
        first = self[f"{process}.{TIMING_COLUMNS[0][0]}_us"]
        columns: dict[str, NDArray[Any]] = {"cycle": timing["cycle"].astype(np.int64)}
        columns |= {name: timing[name] for name in timing if name not in {"cycle", "time_s"}}
        columns |= {name: self[f"{process}.{name}"].values for name in self.probes(process)}
        return pa.table({**_time_arrays(first.bus_time_ns, first.sim_time_s), **columns})

    def to_arrow(self, names: Sequence[str], *, on: str | Array | None = None) -> pa.Table:
        """Columns on one time base: each holds its value until its next sample.

        `on` is the name whose stamps are the base, or times in s since the start; default: the first name.
        Not-a-number before the first sample.
        """
        columns = [self[name] for name in names]
        if not columns:
            raise NotRecorded("no signal was asked for; give at least one name")
        if on is None or isinstance(on, str):
            base = columns[0] if on is None else self[on]
            stamps, seconds = base.bus_time_ns, base.sim_time_s
        else:
            seconds = np.asarray(on, dtype=np.float64)
            stamps = self.start_ns + np.rint(seconds * NS_PER_S).astype(np.int64)
        held = {column.name: column.held_at(stamps) for column in columns}
        return pa.table({**_time_arrays(stamps, seconds), **held})

    def to_pandas(self, names: Sequence[str], *, on: str | Array | None = None) -> Any:
        """`to_arrow` as a pandas DataFrame over `sim_time`. Raises MissingPackage."""
        _pandas()
        return self.to_arrow(names, on=on).to_pandas().set_index("sim_time")

    @cached_property
    def start_ns(self) -> int:
        """Epoch time of the start of the recording, ns."""
        for entity, component, _ in self._places.values():
            (bus_ns, sim_ns), _ = self.integer_columns(entity, component)
            if len(bus_ns):
                return int(bus_ns[0] - sim_ns[0])
        return 0

    @cached_property
    def choices(self) -> Mapping[str, Mapping[int, str]]:
        """Words of the states' values by `Message.Signal`, from the DBC that the recording carries."""
        import cantools.database

        database = cantools.database.load_string(self.dbc, database_format="dbc", strict=False)
        return {
            f"{message.name}.{signal.name}": {int(k): str(word) for k, word in signal.choices.items()}
            for message in getattr(database, "messages", ())
            for signal in message.signals
            if signal.choices
        }

    @cached_property
    def _cache(self) -> dict[str, Column]:
        return {}

    @cached_property
    def _places(self) -> dict[str, tuple[str, str, str]]:
        """Name -> entity, component, unit."""
        places = {}
        for message, about in self.messages.items():
            for signal, unit in about.signals.items():
                component = component_name(message, with_unit(signal, unit))
                places[f"{message}.{signal}"] = (f"/bus/{message}", component, unit)
        for process in self.processes:
            for name, unit in TIMING_COLUMNS:
                key = f"{process}.{name}_us" if unit == "us" else f"{process}.{name}"
                component = component_name(TIMING_GROUP, with_unit(name, unit))
                places[key] = (f"/timing/{process}", component, unit)
            for name, unit in self.probes(process).items():
                component = component_name(process, with_unit(name, unit))
                places[f"{process}.{name}"] = (f"/probe/{process}", component, unit)
        return places

    def _load(self, name: str) -> Column:
        known = name.replace("/", ".", 1)
        if known not in self._places:
            raise NotRecorded(f"{self.path}: no {name!r} in this recording; {self._nearest(known)}")
        entity, component, unit = self._places[known]
        (bus_ns, sim_ns), values = self.integer_columns(entity, component)
        choices = self.choices.get(known, {}) if entity.startswith("/bus/") else {}
        return Column(known, unit, bus_ns, sim_ns / NS_PER_S, values, choices)

    def _nearest(self, name: str) -> str:
        by_lower = {known.lower(): known for known in self._places}
        near = [by_lower[word] for word in difflib.get_close_matches(name.lower(), by_lower, 3, 0.5)]
        tail = name.rpartition(".")[2].lower()
        near += [known for known in self._places if tail and known.lower().endswith(f".{tail}")]
        near = list(dict.fromkeys(near))[:4]
        return f"nearest: {', '.join(near)}" if near else "hil query RUN --list shows what there is"


def _time_arrays(bus_ns: Stamps, seconds: Array) -> dict[str, pa.Array]:
    stamps = pa.array(bus_ns.astype("datetime64[ns]"), pa.timestamp("ns", tz="UTC"))
    return {"bus_time": stamps, "sim_time": pa.array(seconds)}


def _pandas() -> Any:
    if find_spec("pandas") is None:
        raise MissingPackage("tables of pandas need the package pandas: pip install 'ato-hil[pandas]'")
    import pandas  # type: ignore[import-untyped,unused-ignore]

    return pandas


def _run_of_log(log: Path, dbc: Path | None) -> RunData:
    """A run out of a frame log alone: recorded again in a scratch directory. Cycles are not in a log."""
    import tempfile

    from hil.canbus.contract import Contract
    from hil.canbus.frame import EXTENDED_ID_FLAG, Frame
    from hil.record.recorder import MOST_FRAMES_PER_BLOCK, Recorder, RecorderOptions

    frames = (
        Frame(
            round(m.timestamp * NS_PER_S),
            m.arbitration_id | (EXTENDED_ID_FLAG if m.is_extended_id else 0),
            bytes(m.data),
        )
        for m in read_log(log)
        if not (m.is_error_frame or m.is_remote_frame)
    )
    with tempfile.TemporaryDirectory(prefix="hil-") as scratch:
        folder = Path(scratch)
        options = RecorderOptions(folder, properties={"rebuilt_from": log.name}, thin=False)
        with Recorder(Contract.load(dbc), options) as recorder:
            for number, frame in enumerate(frames):
                recorder.feed([frame])
                if number % MOST_FRAMES_PER_BLOCK == 0:
                    recorder.flush()
        run = reader.open_run(folder / RECORDING)
    return RunData(log, f"{log}: read from the frame log; cycles and probes are not in it", run.chunks)


def open_run(path: Path | str, *, dbc: Path | None = None) -> RunData:
    """Open a run directory, its run.rrd, or a frame log in any format. Raises RecordingUnreadable.

    A directory without run.rrd is read from its frames.blf. `dbc` decodes a frame log; default: the shipped
    one. A recording carries its own.
    """
    place = Path(path)
    log = place / FRAME_LOG if place.is_dir() and not (place / RECORDING).is_file() else place
    if log.is_file() and log.suffix.lstrip(".") in FRAME_FORMATS:
        return _run_of_log(log, dbc)
    run = reader.open_run(place)
    return RunData(run.path, run.warning, run.chunks)
