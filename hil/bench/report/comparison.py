"""comparison.html: runs beside each other: criteria, figures, curves over each other, what was different."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.bench.errors import ScenarioError
from hil.bench.report.chart import draw
from hil.bench.report.judgement import CriterionRow, criterion_rows, headline, sentence
from hil.bench.report.overlays import overlay_charts, run_color
from hil.bench.report.page import REPORT_FILE, Written, render, write_page
from hil.bench.report.source import RunSource, links, open_source

__all__ = ["COMPARISON_FILE", "write_comparison"]

COMPARISON_FILE = "comparison.html"
FIGURES = {
    "trip_time_s": ("Trip time", "s"),
    "max_speed_error_mps": ("Largest speed error", "m/s"),
    "acceleration_at_standstill_mps2": ("Acceleration at standstill", "m/s²"),
    "traction_energy_j": ("Traction energy", "MJ"),
    "regenerated_energy_j": ("Braked electrically", "MJ"),
}
MEGA = {"MJ": 1e-6}


@dataclass(frozen=True)
class Side:
    """One of the runs: its name on this page, its colour, where its own report is."""

    name: str
    source: RunSource
    color: int
    headline: str
    sentence: str
    report: str | None


@dataclass(frozen=True)
class Row:
    """One quantity of all runs; `differences` are those from the first run, None where one is not known."""

    name: str
    unit: str
    cells: tuple[Any, ...]
    differences: tuple[float | None, ...] = ()
    limits: tuple[float, ...] = ()


def write_comparison(runs: Sequence[Path], out: Path | None = None) -> Written:
    """Write the comparison of at least two runs to `out`, by default comparison.html beside the first run.

    Raises ScenarioError: fewer than two, no run there, or the file cannot be written.
    """
    if len(runs) < 2:
        raise ScenarioError("a comparison needs at least two runs")
    sources = [open_source(run) for run in runs]
    path = out if out is not None else sources[0].folder.resolve().parent / COMPARISON_FILE
    sides = _sides(sources, path.parent)
    charts = list(overlay_charts([(side.name, side.source) for side in sides]))
    html = render(
        "comparison.html.j2",
        charts,
        page_title="Comparison: " + ", ".join(side.name for side in sides),
        sides=sides,
        criteria=list(_criteria(sources)),
        figures=list(_figures(sources)),
        charts=[(chart, draw(chart)) for chart in charts],
        timing=list(_timing(sources)),
        settings=list(_settings(sources)),
        missing=[(side.name, line) for side in sides for line in side.source.missing],
    )
    return write_page(path, html, sources)


def _sides(sources: Sequence[RunSource], beside: Path) -> list[Side]:
    names = [source.name for source in sources]
    if len(set(names)) < len(names):
        names = [str(source.folder) for source in sources]
    if len(set(names)) < len(names):
        names = [f"{name} ({number + 1})" for number, name in enumerate(names)]
    sides = []
    for place, (name, source) in enumerate(zip(names, sources, strict=True)):
        known = {link.name: link.href for link in links(source, beside, (REPORT_FILE,))}
        href = known.get(REPORT_FILE)
        sides.append(Side(name, source, run_color(place), headline(source), sentence(source), href))
    return sides


def _criteria(sources: Sequence[RunSource]) -> Iterator[Row]:
    tables = [{row.name: row for row in criterion_rows(source.summary)} for source in sources]
    for name in dict.fromkeys(name for table in tables for name in table):
        cells = tuple(table.get(name) for table in tables)
        known = next(cell for cell in cells if cell is not None)
        limits = tuple(dict.fromkeys(cell.limit for cell in cells if cell is not None))
        yield Row(known.title, known.unit, cells, _differences([_value(cell) for cell in cells]), limits)


def _value(cell: CriterionRow | None) -> float | None:
    return None if cell is None else cell.value


def _figures(sources: Sequence[RunSource]) -> Iterator[Row]:
    for key, (name, its_unit) in FIGURES.items():
        found = [source.summary.get("control", {}).get(key) for source in sources]
        values = [None if value is None else value * MEGA.get(its_unit, 1.0) for value in found]
        if any(value is not None for value in values):
            yield Row(name, its_unit, tuple(values), _differences(values))


def _timing(sources: Sequence[RunSource]) -> Iterator[Row]:
    tables = [source.summary.get("timing", {}) for source in sources]
    for process in dict.fromkeys(process for table in tables for process in table):
        for key, title in (("wakeup_latency_us", "wake-up latency"), ("execution_us", "execution")):
            for percentile, sign in (("p50", "p50"), ("p99", "p99"), ("p999", "p99.9"), ("max", "max")):
                values = [
                    None
                    if key == "wakeup_latency_us" and not source.real_time
                    else table.get(process, {}).get(key, {}).get(percentile)
                    for source, table in zip(sources, tables, strict=True)
                ]
                if any(value is not None for value in values):
                    yield Row(f"{process}: {title} {sign}", "µs", tuple(values), _differences(values))


def _settings(sources: Sequence[RunSource]) -> Iterator[Row]:
    """What was not the same: keys of the scenario, then clock, machine and versions."""
    tables = [{**_flat(_toml(source.scenario_text)), **_surroundings(source)} for source in sources]
    for key in dict.fromkeys(key for table in tables for key in table):
        cells = tuple(table.get(key, "–") for table in tables)
        if len({str(cell) for cell in cells}) > 1:
            yield Row(key, "", cells)


def _surroundings(source: RunSource) -> dict[str, Any]:
    summary = source.summary
    kept = {key: summary[key] for key in ("mode", "processes", "law", "seed") if key in summary}
    bus = {f"bus.{key}": summary.get("bus", {}).get(key) for key in ("interface", "bitrate")}
    rights = {
        f"{process}.sched_fifo": timing.get("sched_fifo")
        for process, timing in summary.get("timing", {}).items()
    }
    return {**kept, **bus, **rights, **_flat(summary.get("environment", {}), "environment.")}


def _flat(table: Mapping[str, Any], start: str = "") -> dict[str, Any]:
    rows: dict[str, Any] = {}
    for key, value in table.items():
        rows |= _flat(value, f"{start}{key}.") if isinstance(value, dict) else {f"{start}{key}": value}
    return rows


def _toml(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return {}


def _differences(values: Sequence[float | None]) -> tuple[float | None, ...]:
    """Against the first value; what is only the rounding of floating point is no difference."""
    first = values[0]
    found: list[float | None] = []
    for value in values[1:]:
        if value is None or first is None:
            found.append(None)
        else:
            found.append(0.0 if math.isclose(value, first, rel_tol=1e-9) else value - first)
    return tuple(found)
