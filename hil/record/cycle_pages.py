"""The cycles of the nodes in run.rrd: timing and probes per process, jitter histograms, percentiles."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence

import numpy as np

from hil.node import RingHeader
from hil.record.charts import Charts, Source
from hil.record.dashboard import JERK, PALETTE, RED
from hil.record.derived import Jerk
from hil.record.law_page import LawPage
from hil.record.rerun_sink import RerunSink, with_unit
from hil.record.rings import TIMING_COLUMNS, Cycles
from hil.record.statistics import Histogram, percentile_table
from hil.record.timelines import Instants

__all__ = ["TIMING_GROUP", "CyclePages"]

TIMING_GROUP = "timing"
LATENCY, EXECUTION, MISSED = 0, slice(1, 5), 6  # columns of `Cycles.timing`
DECADES = np.linspace(0.0, 5.0, 51)
"""Edges of the histograms' bars, log10 us: from 1 us to 100 ms."""


class CyclePages:
    """Writes the cycles of all processes; `processes` in the order of their colours."""

    def __init__(
        self, processes: Sequence[str], charts: Charts, sink: RerunSink, law: LawPage | None = None
    ) -> None:
        self.headers: dict[str, RingHeader] = {}
        self._processes = processes
        self._charts = charts
        self._sink = sink
        self._law = law
        self._jerk: dict[str, Jerk] = {}
        self._latency: dict[str, Histogram] = {}
        self._execution: dict[str, Histogram] = {}

    def introduce(self, process: str, header: RingHeader) -> None:
        """Say what the columns of a process are, once, before its first cycle."""
        self.headers[process] = header
        about = {"period_ns": header.period_ns, "clock": header.clock, "probes": dict(header.probes)}
        self._sink.properties(f"process_{process}", {"json": json.dumps(about)})
        self._latency[process], self._execution[process] = Histogram(), Histogram()
        entity, cycles = f"/probe/{process}", f"/timing/{process}"
        sources = {f"{process}/{name}": Source(entity, process, name, unit) for name, unit in header.probes}
        if JERK[0] in sources:
            self._jerk[process] = Jerk(header.period_ns * 1e-9)
            sources[f"{process}/{JERK[1]}"] = Source(entity, process, JERK[1], JERK[2])
        if header.clock == "realtime":
            sources[f"{process}/response"] = Source(cycles, TIMING_GROUP, "response", "us")
            sources[f"{process}/missed"] = Source(cycles, TIMING_GROUP, "missed", "cycles")
        self._charts.offer(sources)

    def write(self, process: str, cycles: Cycles, instants: Instants) -> None:
        """Write new cycles of a process that was introduced."""
        timing = {with_unit(name, unit): cycles.timing[:, k] for k, (name, unit) in enumerate(TIMING_COLUMNS)}
        if self.headers[process].clock == "realtime":
            timing["response [us]"] = cycles.timing[:, LATENCY] + cycles.timing[:, EXECUTION].sum(axis=1)
        self._sink.columns(f"/timing/{process}", TIMING_GROUP, instants, timing)
        probes = {}
        values = {name: cycles.probes[:, k] for k, (name, _) in enumerate(self.headers[process].probes)}
        units = dict(self.headers[process].probes)
        if process in self._jerk:
            values[JERK[1]] = self._jerk[process].add(values[JERK[0].partition("/")[2]])
            units[JERK[1]] = JERK[2]
        for name, column in values.items():
            probes[with_unit(name, units[name])] = column
            probes |= self._charts.take(f"{process}/{name}", instants, column)
        if self._law is not None and self._law.picture.process == process:
            self._law.follow(instants, values)
        self._sink.columns(f"/probe/{process}", process, instants, probes)
        self._latency[process].add(cycles.timing[:, LATENCY])
        self._execution[process].add(cycles.timing[:, EXECUTION].sum(axis=1))

    def derived(self, process: str) -> list[tuple[str, str]]:
        """Name and unit of what is recorded beside the probes of a process."""
        return [JERK[1:]] if process in self._jerk else []

    def redraw(self) -> None:
        """Replace histograms and percentiles by what is known now."""
        kinds: Mapping[str, Mapping[str, Histogram]] = {
            "wakeup_latency": self._latency,
            "execution": self._execution,
        }
        for kind, histograms in kinds.items():
            self._draw_bars(f"/histogram/{kind}", histograms)
        if self._latency:
            rows = {
                f"{process}: wake-up latency": known
                for process, known in self._latency.items()
                if self.headers[process].clock == "realtime"
            }
            rows |= {f"{process}: execution": known for process, known in self._execution.items()}
            self._sink.document("/timing_summary", percentile_table(rows))

    def _draw_bars(self, entity: str, histograms: Mapping[str, Histogram]) -> None:
        """One bar for each process side by side in every bin, and the period as a red one.

        Both axes are logarithmic: the tail of a latency is what matters, and the limit is far from it.
        """
        width = float(DECADES[1] - DECADES[0])
        share = width / max(1, len(histograms))
        heights = {process: histogram.decades(DECADES) for process, histogram in histograms.items()}
        for place, (process, bars) in enumerate(heights.items()):
            color = PALETTE[self._processes.index(process) % len(PALETTE)]
            self._sink.bars(f"{entity}/{process}", bars, DECADES[:-1] + place * share, share, color)
        if heights:
            tallest = max(1.0, *(float(bars.max()) for bars in heights.values()))
            period_us = next(iter(self.headers.values())).period_ns * 1e-3
            at = np.array([math.log10(max(period_us, 1.0))])
            self._sink.bars(f"{entity}/period", np.array([tallest]), at, 0.2 * width, RED)
