"""compare.rrd: the nominal runs of all contenders in one Rerun recording, on one time axis.

Entities are `<quantity>/<law>`, the same four for every law, so one view shows one quantity of all. The times
are those of each run from its start; every run departs at the same time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from hil.bench.compare import Comparison
from hil.bench.comparison_picture import colors
from hil.bench.metrics import Array
from hil.bench.trial import Lines

RECORDING_FILE = "compare.rrd"
APPLICATION_ID = "ato_hil_compare"
QUANTITIES: Mapping[str, str] = {
    "speed": "Speed [km/h]",
    "error": "Speed error, reference - true [m/s]",
    "effort": "Commanded effort [kN]",
    "acceleration": "Acceleration [m/s²]",
}
REFERENCE = "reference"
REFERENCE_COLOR = 0xE6E8EBFF
TABLE = "table"
MM_PER_M = 1e3
MOST_POINTS = 6000
"""Of a line: no screen shows more, and fourteen laws at full rate would be 30 MB."""


def record_comparison(
    comparison: Comparison, folder: Path, table: str, *, viewer_url: str | None = None
) -> Path:
    """Write the recording, `table` (Markdown) with it; to a live viewer as well if its address is given."""
    path = folder / RECORDING_FILE
    recording = rr.RecordingStream(APPLICATION_ID)
    file = rr.FileSink(path, write_footer=True)
    sinks = (file,) if viewer_url is None else (file, rr.GrpcSink(viewer_url))
    recording.set_sinks(*sinks, default_blueprint=blueprint())
    recording.set_log_time_enabled(False)
    recording.send_recording_name(f"compare {comparison.request.scenario}")
    recording.log(TABLE, rr.TextDocument(table, media_type=rr.MediaType.MARKDOWN), static=True)
    chosen = colors(comparison.request.contenders)
    reference_sent = False
    for contender in comparison.request.contenders:
        result = comparison.nominal.get(contender.name)
        if result is None or result.lines is None or not len(result.lines.time_s):
            continue
        if not reference_sent:
            values = {"speed": result.lines.reference_speed_mps * 3.6}
            _send(recording, REFERENCE, values, result.lines, REFERENCE_COLOR, 1.0)
            reference_sent = True
        color = int(chosen[contender.name][1:] + "ff", 16)
        width = 1.8 if contender.preset is None else 1.0
        _send(recording, contender.name, _columns(result.lines), result.lines, color, width)
    recording.flush(timeout_sec=10)
    recording.disconnect()
    return path


def blueprint() -> rrb.Blueprint:
    """One view for each quantity, all laws in it, and the table beside."""
    views = [rrb.TimeSeriesView(origin=f"/{name}", name=title) for name, title in QUANTITIES.items()]
    shares = [1.6, 1.0, 1.0, 1.0]
    return rrb.Blueprint(
        rrb.Tabs(
            rrb.Vertical(*views, row_shares=shares, name="All laws"),
            rrb.TextDocumentView(origin=f"/{TABLE}", name="Table"),
        ),
        rrb.TimePanel(state="collapsed", timeline="sim_time"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _columns(lines: Lines) -> dict[str, Array]:
    return {
        "speed": lines.speed_mps * 3.6,
        "error": lines.error_mps,
        "effort": lines.effort_n * 1e-3,
        "acceleration": lines.acceleration_mps2,
    }


def _send(
    recording: rr.RecordingStream,
    name: str,
    columns: Mapping[str, Array],
    lines: Lines,
    color: int,
    width: float,
) -> None:
    for quantity, values in columns.items():
        entity = f"{quantity}/{name.replace(':', '_')}"
        recording.log(entity, rr.SeriesLines(colors=[color], names=[name], widths=[width]), static=True)
        rows = outline(values, MOST_POINTS)
        indexes: Sequence[rr.TimeColumn] = [
            rr.TimeColumn("sim_time", duration=lines.time_s[rows]),
            rr.TimeColumn("position", sequence=np.round(lines.position_m[rows] * MM_PER_M).astype(np.int64)),
        ]
        recording.send_columns(entity, indexes, rr.Scalars.columns(scalars=values[rows]))


def outline(values: Array, most: int) -> NDArray[np.intp]:
    """Rows (at most about `most`, ascending) that draw the same line: lowest and highest of every stretch.

    Every n-th row would thin out chatter; its outline keeps its width.
    """
    if len(values) <= most:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), most // 2 + 1).astype(np.intp)
    rows = {0, len(values) - 1}
    for start, end in pairwise(edges):
        rows |= {int(start + np.argmin(values[start:end])), int(start + np.argmax(values[start:end]))}
    return np.array(sorted(rows), dtype=np.intp)
