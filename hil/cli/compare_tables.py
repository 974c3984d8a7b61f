"""The tables of `hil compare`: nominal runs side by side, and what many trains make of each law.

A column is a heading, a unit and a cell for each law; the screen and the recording show the same cells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich.table import Table

from hil.bench.compare import Comparison
from hil.bench.spread import Spread, is_unknown, spread
from hil.bench.trial import TrialResult

KWH_PER_J = 1.0 / 3.6e6
NONE = "-"


@dataclass(frozen=True)
class Cells:
    """A table as text: headings, units below them, rows."""

    title: str
    heads: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


NOMINAL: tuple[tuple[str, str, int, Callable[[TrialResult], float | None]], ...] = (
    ("stop", "m", 3, lambda r: r.metrics.stop_error_m),
    ("rms", "m/s", 4, lambda r: r.metrics.rms_speed_error_mps),
    ("max", "m/s", 3, lambda r: r.metrics.max_speed_error_mps),
    ("over", "%", 2, lambda r: r.overshoot_percent),
    ("energy", "kWh", 2, lambda r: _scaled(r.metrics.traction_energy_j, KWH_PER_J)),
    ("jerk", "m/s3", 2, lambda r: r.metrics.max_jerk_mps3),
    ("TVx", "kN/s", 1, lambda r: _scaled(r.chatter.excess_variation_n_per_s, 1e-3)),
    ("HF5", "kN", 2, lambda r: _scaled(r.chatter.ripple_n, 1e-3)),
    ("REV", "1/s", 2, lambda r: r.chatter.reversals_per_s),
    ("step", "us", 1, lambda r: r.step_us),
)
"""Heading, unit, digits, value."""

SPREAD: tuple[tuple[str, str, int, Callable[[Spread], float]], ...] = (
    ("runs", "", 0, lambda s: s.runs),
    ("failed", "", 0, lambda s: s.failed),
    ("P95", "stop m", 3, lambda s: s.stop_p95_m),
    ("P99", "stop m", 3, lambda s: s.stop_p99_m),
    ("worst", "stop m", 3, lambda s: s.stop_worst_m),
    ("of draw", "", 0, lambda s: s.worst_draw),
    ("P95", "rms m/s", 4, lambda s: s.rms_p95_mps),
    ("P95", "max m/s", 3, lambda s: s.max_error_p95_mps),
    ("P95", "jerk", 2, lambda s: s.jerk_p95_mps3),
)

EXPLANATION = (
    "stop: error, positive past the stop; rms, max: speed error; over: highest speed above the highest"
    " reference; energy: traction work at the wheel rim; TVx, HF5, REV: variation of the command beyond the"
    " ideal one, its ripple above 5 Hz, its turning points, all from 3 s on; step: median of the controller's"
    " whole cycle"
)


def nominal_cells(comparison: Comparison) -> Cells:
    """The nominal runs."""
    rows = []
    for contender in comparison.request.contenders:
        result = comparison.nominal.get(contender.name)
        row = [NONE if result is None else number(value(result), digits) for _, _, digits, value in NOMINAL]
        failed = result is not None and result.failure
        rows.append((contender.name + (" *" if failed else ""), *row))
    return Cells(
        f"{comparison.request.scenario}, nominal train (*: failed, see below)",
        ("law", *(name for name, *_ in NOMINAL)),
        ("", *(unit for _, unit, *_ in NOMINAL)),
        tuple(rows),
    )


def spread_cells(comparison: Comparison) -> Cells:
    """The drawn trains; no rows if there are none."""
    rows = []
    for contender in comparison.request.contenders:
        results = comparison.drawn.get(contender.name)
        if not results:
            continue
        stats, nominal = spread(results), comparison.nominal.get(contender.name)
        first = NONE if nominal is None else number(_size(nominal.metrics.stop_error_m), 3)
        rows.append((contender.name, first, *(number(value(stats), d) for _, _, d, value in SPREAD)))
    request = comparison.request
    return Cells(
        f"trains of the {request.set_name} set, seed {request.seed}: |stop error| and others",
        ("law", "nominal", *(name for name, *_ in SPREAD)),
        ("", "stop m", *(unit for _, unit, *_ in SPREAD)),
        tuple(rows),
    )


def number(value: float | None, digits: int) -> str:
    """A number for a table; `none` where so many runs gave no value."""
    if value is None:
        return NONE
    return "none" if is_unknown(value) else f"{value:.{digits}f}"


def screen(cells: Cells) -> Table:
    """A table for the screen, numbers to the right, no wider than 80 characters."""
    result = Table(
        title=cells.title,
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    for place, (head, unit) in enumerate(zip(cells.heads, cells.units, strict=True)):
        heading = head if place == 0 else f"{head}\n[dim]{unit}[/dim]"
        result.add_column(heading, justify="right" if place else "left", no_wrap=True)
    failed = cells.heads.index("failed") if "failed" in cells.heads else -1
    for row in cells.rows:
        shown = [f"[red]{cell}[/red]" if k == failed and cell != "0" else cell for k, cell in enumerate(row)]
        result.add_row(*shown)
    return result


def markdown(tables: Sequence[Cells]) -> str:
    """The same as Markdown."""
    lines = []
    for cells in tables:
        heads = [
            f"{head} [{unit}]" if unit else head for head, unit in zip(cells.heads, cells.units, strict=True)
        ]
        lines += [f"## {cells.title}", "", f"| {' | '.join(heads)} |", "|" + "--:|" * len(heads)]
        lines += [*(f"| {' | '.join(row)} |" for row in cells.rows), ""]
    return "\n".join([*lines, EXPLANATION])


def _size(value: float | None) -> float | None:
    return None if value is None else abs(value)
