"""Several runs in one recording, on one time axis: the viewer itself does not lay recordings over each other.

Each run is drawn from its own departure, speed, tracking error, effort demand and acceleration, with its name
in the legend. The timeline `position` places the same lines over the odometer (mm).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from hil.record.dashboard import GREY, POSITION, RED, colors
from hil.record.errors import NotRecorded, RecordError
from hil.record.run_data import Column, RunData, open_run
from hil.record.thinning import Thinner

__all__ = ["record_comparison", "run_names"]

APPLICATION_ID = "ato_hil_view"
DEPARTURE = ("ATO_Command.Mode", "RUN")
QUANTITIES: tuple[tuple[str, str, tuple[str, ...], float], ...] = (
    ("speed", "Speed [km/h]", ("plant_sim.speed_mps",), 3.6),
    ("speed", "Speed [km/h]", ("ODO_Motion.Speed",), 1.0),
    (
        "speed_error",
        "Tracking error, reference minus measured speed [m/s]",
        ("controller.speed_error_mps",),
        1.0,
    ),
    ("demand", "Effort demand [%]", ("ATO_Command.EffortDemand",), 1.0),
    ("acceleration", "Acceleration [m/s^2]", ("plant_sim.acceleration_mps2",), 1.0),
)
"""Path, title, source, factor to the unit of the title; of one path the first source that exists."""

PERMITTED = ("ATP_Permission.PermittedSpeed", "permitted")
REFERENCE = ("controller.reference_speed_mps", "reference")
SHARES = {"speed": 2.2, "speed_error": 1.3, "demand": 1.2, "acceleration": 1.2}
MOST_ROWS = 20_000
"""Of a line that is drawn as it is; longer ones are thinned."""

NS_PER_S = 1e9
Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Line:
    """A column of a run, from the run's departure."""

    time_s: Array
    position_mm: NDArray[np.int64]
    values: Array


def record_comparison(runs: Sequence[Path], path: Path) -> Path:
    """Write a recording in which the runs lie over each other. Raises RecordError, RecordingUnreadable."""
    if len(runs) < 2:
        raise RecordError("to compare, give two runs or more")
    names = run_names(runs)
    tints = dict(zip(names, colors(len(names)), strict=True))
    recording = rr.RecordingStream(APPLICATION_ID)
    recording.set_sinks(rr.FileSink(path, write_footer=True), default_blueprint=_blueprint(longest_s(runs)))
    recording.set_log_time_enabled(False)
    recording.send_recording_name("compare " + ", ".join(names))
    rows = []
    for name, run in zip(names, runs, strict=True):
        data = open_run(run)
        if name == names[0]:
            _draw_reference(recording, data)
        for quantity, line in _lines(data).items():
            _send(recording, f"{quantity}/{_entity(name)}", name, tints[name], 1.5, line)
        rows.append(_table_row(name, data))
    table = "\n".join([*TABLE_HEAD, *rows])
    recording.log("table", rr.TextDocument(table, media_type=rr.MediaType.MARKDOWN), static=True)
    recording.flush(timeout_sec=10)
    recording.disconnect()
    return path


def run_names(runs: Sequence[Path]) -> list[str]:
    """A name for each run: its folder, longer where two are alike, and its law if the runs differ there."""
    folders = [run.resolve() if run.is_dir() else run.resolve().parent for run in runs]
    names = [folder.name for folder in folders]
    depth = 1
    while len(set(names)) < len(names) and depth < 4:
        depth += 1
        names = ["/".join(folder.parts[-depth:]) for folder in folders]
    if len(set(names)) < len(names):
        names = [f"{name} ({number})" for number, name in enumerate(names, 1)]
    laws = [_law(open_run(run)) for run in runs]
    if len(set(laws)) > 1:
        names = [
            f"{name}: {law}" if law and law not in name else name
            for name, law in zip(names, laws, strict=True)
        ]
    return names


TABLE_HEAD = ("| run | scenario | law | seed | verdict | stop error | rms speed error | jerk |",
              "|:---|:---|:---|---:|:---|---:|---:|---:|")  # fmt: skip


def _table_row(name: str, data: RunData) -> str:
    summary = data.summary
    known = {row["name"]: row for row in summary.get("criteria", ())}

    def shown(criterion: str) -> str:
        row = known.get(criterion)
        return "-" if row is None or row["value"] is None else f"{row['value']:.4g} {row['unit']}"

    cells = [name, *(str(summary.get(key, "-")) for key in ("scenario", "law", "seed", "verdict"))]
    cells += [shown(criterion) for criterion in ("stop_error", "rms_speed_error", "jerk")]
    return "| " + " | ".join(cells) + " |"


def longest_s(runs: Sequence[Path]) -> float:
    """Duration of the longest run from its departure [s]."""
    ends = [line.time_s[-1] for run in runs for line in _lines(open_run(run)).values() if len(line.time_s)]
    return float(max(ends, default=1.0))


def _law(data: RunData) -> str:
    return str(data.summary.get("law") or data.properties.get("law") or "")


def _lines(data: RunData) -> dict[str, _Line]:
    found: dict[str, _Line] = {}
    for path, _, sources, factor in QUANTITIES:
        for source in sources:
            column = _column(data, source)
            if path not in found and column is not None and len(column):
                found[path] = _placed(data, column, factor)
    return found


def _column(data: RunData, name: str) -> Column | None:
    try:
        return data[name]
    except NotRecorded:
        return None


def _placed(data: RunData, column: Column, factor: float) -> _Line:
    """A column from the departure on, thinned to what a line needs, with the odometer beside it."""
    position = _column(data, POSITION)
    start_s = _departure_s(data)
    rows = np.flatnonzero(column.sim_time_s >= start_s)
    if len(rows) > MOST_ROWS:
        rows = rows[Thinner().rows(column.values[rows])]
    at = column.bus_time_ns[rows]
    known = np.zeros(len(rows)) if position is None else np.nan_to_num(position.held_at(at))
    return _Line(
        column.sim_time_s[rows] - start_s, np.rint(known).astype(np.int64), column.values[rows] * factor
    )


def _departure_s(data: RunData) -> float:
    mode = _column(data, DEPARTURE[0])
    if mode is None:
        return 0.0
    number = next((value for value, name in mode.choices.items() if name == DEPARTURE[1]), None)
    running = np.flatnonzero(mode.values == number) if number is not None else np.empty(0, np.intp)
    return float(mode.sim_time_s[running[0]]) if len(running) else 0.0


def _draw_reference(recording: rr.RecordingStream, data: RunData) -> None:
    for (source, name), factor, color in ((PERMITTED, 1.0, RED), (REFERENCE, 3.6, GREY)):
        column = _column(data, source)
        if column is not None and len(column):
            _send(recording, f"speed/{name}", name, color, 1.0, _placed(data, column, factor))


def _send(
    recording: rr.RecordingStream, entity: str, name: str, color: int, width: float, line: _Line
) -> None:
    style = rr.SeriesLines(names=[name], colors=np.array([color], dtype=np.uint32), widths=[width])
    recording.log(entity, style, static=True)
    times = np.rint(line.time_s * NS_PER_S).astype(np.int64).astype("timedelta64[ns]")
    recording.send_columns(
        entity,
        [rr.TimeColumn("sim_time", duration=times), rr.TimeColumn("position", sequence=line.position_mm)],
        rr.Scalars.columns(scalars=line.values),
    )


def _blueprint(duration_s: float) -> rrb.Blueprint:
    boundary: Callable[..., rrb.TimeRangeBoundary] = rrb.TimeRangeBoundary.absolute
    whole = rrb.TimeRange(start=boundary(seconds=0.0), end=boundary(seconds=duration_s))
    titles = {path: title for path, title, _, _ in QUANTITIES}
    views = [
        rrb.TimeSeriesView(
            origin=f"/{path}",
            name=title,
            axis_x=rrb.TimeAxis(view_range=whole),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=path == "speed"),
        )
        for path, title in titles.items()
    ]
    shares = [SHARES[path] for path in titles]
    table = rrb.TextDocumentView(origin="/table", name="Verdicts")
    return rrb.Blueprint(
        rrb.Tabs(rrb.Vertical(*views, row_shares=shares, name="Runs"), table, active_tab=0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="sim_time", play_state="paused"),
        auto_layout=False,
        auto_views=False,
    )


def _entity(name: str) -> str:
    return "".join(character if character.isalnum() or character in "-_." else "_" for character in name)
