"""How a run kept time: histograms of wake-up latency and execution beside their limits, for each process."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.bench.metrics import Array, percentiles_us
from hil.bench.report.axes import plain
from hil.bench.report.chart import Bars, Chart, Mark
from hil.bench.report.source import RunSource
from hil.bench.timing.limits import TimingLimits, load_limits
from hil.record.dashboard import BLUE, VIOLET

__all__ = ["ProcessTiming", "process_timings"]

CONTROLLER = "controller"
FLOOR_US = 0.1
BINS_PER_DECADE = 12
PERCENTILES = {"p50": "p50", "p99": "p99", "p999": "p99.9", "max": "max"}


@dataclass(frozen=True)
class Row:
    """One distribution in numbers [us], with its limits where there are any."""

    name: str
    values: Mapping[str, float]
    limits: Mapping[str, float]

    def exceeds(self, percentile: str) -> bool:
        """Whether a percentile is above its limit."""
        limit = self.limits.get(percentile)
        return limit is not None and self.values[percentile] > limit


@dataclass(frozen=True)
class ProcessTiming:
    """One process: its counters, the percentiles, the histograms; `note` says why something is not there."""

    name: str
    counters: Mapping[str, Any]
    rows: tuple[Row, ...]
    charts: tuple[Chart, ...]
    note: str = ""


def process_timings(source: RunSource) -> list[ProcessTiming]:
    """Timing of every process that was recorded or has a row in the summary."""
    summary = source.summary.get("timing", {})
    recorded = source.recording.processes if source.recording is not None else ()
    limits = load_limits()
    return [
        _process(source, name, summary.get(name, {}), limits) for name in dict.fromkeys([*summary, *recorded])
    ]


def _process(source: RunSource, name: str, told: Mapping[str, Any], limits: TimingLimits) -> ProcessTiming:
    run = source.recording
    timing: Mapping[str, Array] = {}
    if run is not None and name in run.processes:
        with suppress(KeyError, ValueError):  # a recording that was cut off, or of an older bench
            timing = run.timing(name)
    period_us = float(told.get("period_s") or 0.0) * 1e6
    rows: list[Row] = []
    charts: list[Chart] = []
    kinds = {"wakeup_latency_us": ("wake-up latency", BLUE), "execution_us": ("execution", VIOLET)}
    notes = (
        [] if timing else ["No cycles of this process are in the recording: percentiles only, no histogram."]
    )
    for key, (title, color) in kinds.items():
        if key == "wakeup_latency_us" and not source.real_time:
            notes.append("Not in real time: there is no schedule to be late for, hence no wake-up latency.")
            continue
        values = timing.get(key, np.empty(0))
        held = _limits(limits, key) if name == CONTROLLER and source.real_time else {}
        known = percentiles_us(values) if len(values) else told.get(key)
        if known:
            rows.append(Row(title, known, held))
        if len(values):
            charts.append(_histogram(f"{name}-{key}", name, title, color, values, held, period_us))
    return ProcessTiming(name, told, tuple(rows), tuple(charts), " ".join(notes))


def _limits(limits: TimingLimits, key: str) -> dict[str, float]:
    table = getattr(limits, key, None)
    return {} if table is None else {name: float(value) for name, value in table if value is not None}


def _histogram(
    key: str,
    process: str,
    title: str,
    color: int,
    values: Array,
    limits: Mapping[str, float],
    period_us: float,
) -> Chart:
    high = max(float(values.max()), period_us, *limits.values(), 10.0)
    decades = int(np.ceil(np.log10(high / FLOOR_US) - 1e-9))
    edges = FLOOR_US * 10.0 ** (np.arange(decades * BINS_PER_DECADE + 1) / BINS_PER_DECADE)
    counts, _ = np.histogram(np.clip(values, FLOOR_US, edges[-1]), edges)
    # A single cycle has to be seen: a bar of one reaches above the base line at 0.5.
    heights = np.where(counts > 0, np.log10(np.maximum(counts, 1)), -0.5)
    known = percentiles_us(values)
    marks = [Mark(known[p], f"{PERCENTILES[p]} {_us(known[p])}", "x", "place") for p in ("p99", "max")]
    marks += [Mark(value, f"limit {PERCENTILES[p]} {_us(value)}", "x") for p, value in limits.items()]
    if period_us > 0:
        marks.append(Mark(period_us, f"period {_us(period_us)}", "x"))
    marks = [mark for mark in marks if mark.at >= FLOOR_US]
    percentiles = ", ".join(f"{PERCENTILES[p]} {_us(known[p])}" for p in PERCENTILES)
    return Chart(
        key,
        f"{process}: {title}",
        "µs, powers of ten",
        "cycles",
        bars=[Bars(title, color, edges, heights)],
        marks=marks,
        x_range=(FLOOR_US, float(edges[-1])),
        y_range=(-0.4, float(np.log10(max(counts.max(), 10))) + 0.25),
        log=True,
        log_count=True,
        height_em=13.0,
        says=f"Histogram of the {title} of {process} over {len(values)} cycles: {percentiles} microseconds.",
    )


def _us(value: float) -> str:
    return plain(float(f"{value:.3g}") if value < 1000 else round(value))
