"""report.html of one run, and what both pages share: the template environment and the writing of the file."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jinja2

from hil import __version__
from hil.bench.errors import ScenarioError
from hil.bench.report.bus_load import bus_load
from hil.bench.report.chart import Chart, draw
from hil.bench.report.colours import style_sheet, variable
from hil.bench.report.events import MOST_EVENTS, event_rows
from hil.bench.report.judgement import criterion_rows, figures, headline, number, sentence, signed
from hil.bench.report.pictures import run_charts
from hil.bench.report.source import RunSource, links, open_source
from hil.bench.report.timing import process_timings
from hil.record.dashboard import BLUE, PALETTE

__all__ = ["REPORT_FILE", "Written", "rights_rows", "write_page", "write_report"]

REPORT_FILE = "report.html"
ALWAYS_USED = (BLUE, *PALETTE)  # the bars of the bus load, the runs of a comparison


@dataclass(frozen=True)
class Written:
    """A report that was written; `missing` says what it had to leave out."""

    path: Path
    runs: tuple[str, ...]
    verdicts: tuple[str, ...]
    missing: tuple[str, ...]
    bytes: int

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        runs = [
            {"run": run, "verdict": verdict} for run, verdict in zip(self.runs, self.verdicts, strict=True)
        ]
        return {"report": str(self.path), "runs": runs, "missing": list(self.missing), "bytes": self.bytes}


def write_report(run: Path, out: Path | None = None) -> Written:
    """Write the report of a run directory to `out`, by default report.html in it.

    Raises ScenarioError: no run there, or the file cannot be written.
    """
    source = open_source(run)
    path = out if out is not None else source.folder / REPORT_FILE
    charts = list(run_charts(source))
    timings = process_timings(source)
    events = event_rows(source)
    told = [event for event in events if not event.minor]
    html = render(
        "run.html.j2",
        [*charts, *(chart for timing in timings for chart in timing.charts)],
        source=source,
        page_title=f"{headline(source)}: {source.title}",
        headline=headline(source),
        sentence=sentence(source),
        figures=figures(source.summary),
        rows=criterion_rows(source.summary),
        charts=[(chart, draw(chart)) for chart in charts],
        timings=[(timing, [(chart, draw(chart)) for chart in timing.charts]) for timing in timings],
        bus=bus_load(source),
        events=told[:MOST_EVENTS],
        more_events=max(0, len(told) - MOST_EVENTS),
        all_events=events[:MOST_EVENTS] if len(events) > len(told) else [],
        event_count=len(events),
        rights=rights_rows(source.summary),
        links=links(source, path.parent),
    )
    return write_page(path, html, [source])


def render(template: str, drawn: Sequence[Chart], /, **values: Any) -> str:
    """Fill a template; the colours that the charts use become variables of both themes."""
    colors = [*ALWAYS_USED, *(color for chart in drawn for color in chart.colors)]
    return (
        _environment()
        .get_template(template)
        .render(
            light_colors=style_sheet(colors, dark=False),
            dark_colors=style_sheet(colors, dark=True),
            bench_version=__version__,
            **values,
        )
    )


def write_page(path: Path, html: str, sources: Sequence[RunSource]) -> Written:
    """Write the file as a whole or not at all."""
    scratch = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            scratch.write_text(html, encoding="utf-8")
            scratch.replace(path)
        finally:
            scratch.unlink(missing_ok=True)
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be written: {error.strerror or error}") from None
    return Written(
        path,
        tuple(source.name for source in sources),
        tuple(source.verdict for source in sources),
        tuple(
            line if len(sources) == 1 else f"{source.name}: {line}"
            for source in sources
            for line in source.missing
        ),
        len(html.encode("utf-8")),
    )


def rights_rows(summary: Mapping[str, Any]) -> list[tuple[str, dict[str, str]]]:
    """Process and right (name, state, detail, remedy), for those that were asked for."""
    return [
        (process, {**right, "name": right["name"].replace("_", " ")})
        for process, timing in summary.get("timing", {}).items()
        for right in timing.get("rights", {}).values()
        if isinstance(right, dict) and right.get("state") != "not asked for"
    ]


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("hil.bench.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = number
    environment.filters["signed"] = signed
    environment.filters["variable"] = variable
    return environment
