"""Writes the figures of a study as a Rerun recording: the same series, and the table as text.

Entities are `<figure>/<panel>/<line>`; figures over time are on the timeline `sim_time`, those over distance
on `position` (mm), as in the recordings of the bench. Figures over anything else are drawn only.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from hil.record.dashboard import BLUE, GREEN, GREY, ORANGE, RED, VIOLET, WHITE
from studies.figure import Figure, Line, Panel, Role, thin
from studies.study import Study
from studies.table import summary_line

__all__ = ["APPLICATION_ID", "TABLE_ENTITY", "entity", "record"]

APPLICATION_ID = "ato_hil_study"
TABLE_ENTITY = "table"
MM_PER_M = 1000.0
MOST_POINTS = 8000

COLORS: Mapping[Role, int] = {
    "reference": WHITE,
    "limit": RED,
    "disturbance": GREY,
    "ideal": GREY,
    "a": BLUE,
    "b": ORANGE,
    "c": GREEN,
    "d": VIOLET,
    "e": 0x39C5CFFF,
}
"""As in the pictures, for the viewer's dark ground."""


def record(study: Study, path: Path) -> None:
    """Write the recording of a study."""
    recording = rr.RecordingStream(APPLICATION_ID)
    recording.set_sinks(rr.FileSink(path, write_footer=True), default_blueprint=_blueprint(study))
    recording.set_log_time_enabled(False)
    recording.send_recording_name(f"study {study.name}")
    recording.log(TABLE_ENTITY, rr.TextDocument(markdown(study), media_type="text/markdown"), static=True)
    sent: set[str] = set()
    for figure in study.figures:
        if figure.axis == "other":
            continue
        for panel in figure.panels:
            for line in panel.lines:
                place = entity(figure, panel, line)
                if place not in sent:
                    _send(recording, figure, place, line)
                    sent.add(place)
    recording.flush(timeout_sec=10)
    recording.disconnect()


def entity(figure: Figure, panel: Panel, line: Line) -> str:
    """Where a line is recorded: under the first panel that shows it, as details repeat the lines."""
    first = next((other for other in figure.panels if any(line is known for known in other.lines)), panel)
    return "/".join(_word(text) for text in (figure.name, first.title, line.label))


def markdown(study: Study) -> str:
    """The table and the sentences of a study."""
    lines = [f"# {study.title}", study.paper, "", f"**{summary_line(study.rows)}**", ""]
    lines += [
        "| quantity | unit | paper | ours | ratio | reproduced | why |",
        "|---|---|--:|--:|--:|---|---|",
    ]
    for row in study.rows:
        verdict = {True: "yes", False: "**no**", None: ""}[row.reproduced]
        numbers = " | ".join("" if n is None else f"{n:.4g}" for n in (row.paper, row.ours, row.ratio))
        name = f"{row.group}: {row.quantity}" if row.group else row.quantity
        lines.append(f"| {name} | {row.unit} | {numbers} | {verdict} | {row.note} |")
    for head, sentences in (
        ("Where the paper contradicts itself or physics", study.contradictions),
        ("Assumptions", study.assumptions),
    ):
        if sentences:
            lines += ["", f"## {head}", *(f"- {sentence}" for sentence in sentences)]
    return "\n".join(lines)


def _send(recording: rr.RecordingStream, figure: Figure, path: str, line: Line) -> None:
    style = rr.SeriesLines(
        colors=[COLORS[line.role]],
        names=[line.label],
        widths=[1.5],
        interpolation_mode="StepAfter" if line.step else "Linear",
    )
    recording.log(path, style, static=True)
    x, y = thin(line.x, line.y, MOST_POINTS)
    if figure.axis == "time_s":
        index = rr.TimeColumn("sim_time", duration=x)
    else:
        # The train may roll back: a timeline has no direction, so the rows are sorted by position.
        order = np.argsort(x, kind="stable")
        x, y = x[order], y[order]
        index = rr.TimeColumn("position", sequence=np.round(x * MM_PER_M).astype(np.int64))
    recording.send_columns(path, indexes=[index], columns=rr.Scalars.columns(scalars=y))


def _blueprint(study: Study) -> rrb.Blueprint:
    tabs: list[rrb.View | rrb.Container] = [rrb.TextDocumentView(origin=TABLE_ENTITY, name="Table")]
    for figure in study.figures:
        if figure.axis == "other":
            continue
        views = [
            rrb.TimeSeriesView(
                origin="/",
                contents=[f"/{entity(figure, panel, line)}" for line in panel.lines],
                name=f"{panel.title}: {panel.y_label}",
                axis_x=_axis(figure, panel),
                axis_y=rrb.ScalarAxis(range=panel.y_limits) if panel.y_limits else None,
            )
            for panel in figure.panels
        ]
        tabs.append(rrb.Grid(*views, grid_columns=figure.columns, name=figure.name))
    timeline = "sim_time" if any(figure.axis == "time_s" for figure in study.figures) else "position"
    return rrb.Blueprint(
        rrb.Tabs(*tabs),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, play_state="paused"),
        auto_layout=False,
        auto_views=False,
    )


def _axis(figure: Figure, panel: Panel) -> rrb.TimeAxis | None:
    """What a detail shows of its lines."""
    if panel.x_limits is None:
        return None
    start, end = panel.x_limits
    boundary = rrb.TimeRangeBoundary.absolute
    if figure.axis == "time_s":
        return rrb.TimeAxis(
            view_range=rrb.TimeRange(start=boundary(seconds=start), end=boundary(seconds=end))
        )
    first, last = (boundary(seq=round(MM_PER_M * place)) for place in (start, end))
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=first, end=last))


def _word(text: str) -> str:
    """A part of an entity path: letters, digits, and underscores for all else."""
    return re.sub(r"[^0-9A-Za-z]+", "_", text).strip("_") or "_"
