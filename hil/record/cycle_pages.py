"""The cycles of the nodes in run.rrd: timing and probes per process, jitter histograms, percentiles."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence

import numpy as np

from hil.node import RingHeader
from hil.record.charts import Charts, Source
from hil.record.dashboard import PALETTE
from hil.record.rerun_sink import RerunSink, with_unit
from hil.record.rings import TIMING_COLUMNS, Cycles
from hil.record.statistics import Histogram, percentile_table
from hil.record.timelines import Instants

__all__ = ["TIMING_GROUP", "CyclePages"]

TIMING_GROUP = "timing"
BINS = 50
LATENCY, EXECUTION = 0, slice(1, 4)  # columns of `Cycles.timing`


class CyclePages:
    """Writes the cycles of all processes; `processes` in the order of their colours."""

    def __init__(self, processes: Sequence[str], charts: Charts, sink: RerunSink) -> None:
        self.headers: dict[str, RingHeader] = {}
        self._processes = processes
        self._charts = charts
        self._sink = sink
        self._latency: dict[str, Histogram] = {}
        self._execution: dict[str, Histogram] = {}

    def introduce(self, process: str, header: RingHeader) -> None:
        """Say what the columns of a process are, once, before its first cycle."""
        self.headers[process] = header
        about = {"period_ns": header.period_ns, "clock": header.clock, "probes": dict(header.probes)}
        self._sink.properties(f"process_{process}", {"json": json.dumps(about)})
        self._latency[process], self._execution[process] = Histogram(), Histogram()
        entity = f"/probe/{process}"
        self._charts.offer(
            {f"{process}/{name}": Source(entity, process, name, unit) for name, unit in header.probes}
        )

    def write(self, process: str, cycles: Cycles, instants: Instants) -> None:
        """Write new cycles of a process that was introduced."""
        timing = {with_unit(name, unit): cycles.timing[:, k] for k, (name, unit) in enumerate(TIMING_COLUMNS)}
        self._sink.columns(f"/timing/{process}", TIMING_GROUP, instants, timing)
        probes = {}
        for k, (name, unit) in enumerate(self.headers[process].probes):
            probes[with_unit(name, unit)] = cycles.probes[:, k]
            probes |= self._charts.take(f"{process}/{name}", instants, cycles.probes[:, k])
        self._sink.columns(f"/probe/{process}", process, instants, probes)
        self._latency[process].add(cycles.timing[:, LATENCY])
        self._execution[process].add(cycles.timing[:, EXECUTION].sum(axis=1))

    def redraw(self) -> None:
        """Replace histograms and percentiles by what is known now."""
        kinds: Mapping[str, Mapping[str, Histogram]] = {
            "wakeup_latency": self._latency,
            "execution": self._execution,
        }
        for kind, histograms in kinds.items():
            self._draw_bars(f"/histogram/{kind}", histograms)
        if self._latency:
            rows = {f"{process}: wake-up latency": known for process, known in self._latency.items()}
            rows |= {f"{process}: execution": known for process, known in self._execution.items()}
            self._sink.document("/timing_summary", percentile_table(rows))

    def _draw_bars(self, entity: str, histograms: Mapping[str, Histogram]) -> None:
        """One bar for each process side by side in every bin.

        The axis ends at twice the 99.9th percentile: one outlier shall not squeeze all others into a bar.
        """
        tails = [2 * histogram.percentile(99.9) for histogram in histograms.values()]
        longest = max((histogram.maximum for histogram in histograms.values()), default=1.0)
        width_us = max(1, math.ceil(min(max(tails, default=1.0), longest) / BINS))
        bins = BINS
        share = width_us / max(1, len(histograms))
        for place, (process, histogram) in enumerate(histograms.items()):
            color = PALETTE[self._processes.index(process) % len(PALETTE)]
            left_us = np.arange(bins, dtype=np.float64) * width_us + place * share
            self._sink.bars(f"{entity}/{process}", histogram.bars(width_us, bins), left_us, share, color)
