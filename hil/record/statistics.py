"""What a recording says about itself: jitter histograms, percentiles, rates, gaps. Memory does not grow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.canbus.contract import Contract, MessageCodec
from hil.canbus.protection import COUNTER_MODULUS
from hil.record.blocks import Block, MessageBlock

__all__ = ["BusStatistics", "Histogram", "percentile_table"]

NS_PER_S = 1_000_000_000


class Histogram:
    """Counts durations in bins of 1 us up to 50 ms, what is longer in the last; keeps the maximum."""

    BINS = 50_000

    def __init__(self) -> None:
        self.counts = np.zeros(self.BINS + 1, np.int64)
        self.maximum = 0.0

    def add(self, values_us: NDArray[np.float64]) -> None:
        """Count durations, us; a negative one counts as 0."""
        if len(values_us):
            bins = np.clip(values_us, 0, self.BINS).astype(np.int64)
            self.counts += np.bincount(bins, minlength=self.BINS + 1)
            self.maximum = max(self.maximum, float(np.max(values_us)))

    def percentile(self, percent: float) -> float:
        """Upper edge [us] of the bin that holds this share of all; the maximum for 100."""
        total = int(self.counts.sum())
        if not total:
            return 0.0
        rank = int(np.searchsorted(np.cumsum(self.counts), np.ceil(total * percent / 100)))
        return min(float(rank + 1), self.maximum)

    def decades(self, edges: NDArray[np.float64]) -> NDArray[np.float64]:
        """log10(1 + count) between edges [log10 us], ascending (n+1); what lies outside goes to the ends."""
        middles = np.log10(np.arange(len(self.counts)) + 0.5)
        places = np.clip(np.searchsorted(edges, middles, side="right") - 1, 0, len(edges) - 2)
        heights: NDArray[np.float64] = np.log10(1.0 + np.bincount(places, self.counts, len(edges) - 1))
        return heights

    def bars(self, width_us: int, bins: int) -> NDArray[np.float64]:
        """log10(1 + count) of `bins` bins of this width from 0 on; the last one also holds what is longer."""
        end = bins * width_us
        counts = np.zeros(end, np.int64)
        known = self.counts[:end]
        counts[: len(known)] = known
        counts[-1] += self.counts[end:].sum()
        heights: NDArray[np.float64] = np.log10(1.0 + counts.reshape(bins, width_us).sum(axis=1))
        return heights


def percentile_table(histograms: Mapping[str, Histogram]) -> str:
    """A table in Markdown: one row each, in us."""
    lines = ["| us | p50 | p99 | p99.9 | max | cycles |", "|:---|---:|---:|---:|---:|---:|"]
    for name, histogram in histograms.items():
        p50, p99, p999 = (histogram.percentile(percent) for percent in (50, 99, 99.9))
        counts = int(histogram.counts.sum())
        lines.append(f"| {name} | {p50:.0f} | {p99:.0f} | {p999:.0f} | {histogram.maximum:.0f} | {counts} |")
    return "\n".join(lines)


@dataclass
class _Heard:
    """One message so far: what a second of statistics is made of."""

    codec: MessageCodec
    frames: int = 0
    lost: int = 0  # by the counter
    repeated: int = 0
    last_ns: int | None = None
    last_counter: int | None = None
    frames_before: int = 0
    longest_ns: int = 0
    shortest_ns: int | None = None


@dataclass
class BusStatistics:
    """Counts frames, gaps and counter errors of every message; a row of each about once a second."""

    contract: Contract
    heard: dict[str, _Heard] = field(init=False)
    _row_ns: int | None = None

    def __post_init__(self) -> None:
        self.heard = {name: _Heard(codec) for name, codec in self.contract.messages.items()}

    def count(self, block: Block, times_ns: NDArray[np.int64]) -> None:
        """Take a block, `times_ns` being the epoch ns of its frames."""
        for name, message in block.messages.items():
            heard, times = self.heard[name], times_ns[message.rows]
            heard.frames += len(times)
            known = times if heard.last_ns is None else np.concatenate(([heard.last_ns], times))
            if len(known) > 1:
                gaps = np.diff(known)
                heard.longest_ns = max(heard.longest_ns, int(gaps.max()))
                shortest = int(gaps.min())
                heard.shortest_ns = (
                    shortest if heard.shortest_ns is None else min(heard.shortest_ns, shortest)
                )
            heard.last_ns = int(times[-1])
            role = [k for k, signal in enumerate(message.codec.signals) if signal.role == "COUNTER"]
            if role:
                self._count_gaps(heard, message.values[:, role[0]].astype(np.int64))
        if self._row_ns is None and len(times_ns):
            self._row_ns = int(times_ns[0])

    def take(
        self, block: Block, times_ns: NDArray[np.int64]
    ) -> list[tuple[int, dict[str, dict[str, float]]]]:
        """Count a block second by second, however long it is: the rows that it completes, with their time."""
        rows = []
        begin, count = 0, len(times_ns)
        while begin < count:
            start = int(times_ns[begin]) if self._row_ns is None else self._row_ns
            # A second ends with the first frame that is a second late.
            end = min(int(np.searchsorted(times_ns, start + NS_PER_S)) + 1, count)
            end = max(end, begin + 1)
            self.count(_part(block, begin, end), times_ns[begin:end])
            row = self.row(int(times_ns[end - 1]))
            if row is not None:
                rows.append((int(times_ns[end - 1]), row))
            begin = end
        return rows

    def row(self, now_ns: int) -> dict[str, dict[str, float]] | None:
        """Once a second, of the messages heard so far: kind of figure -> message -> value.

        `frames_per_second`; `longest_interval` and `shortest_interval` in percent of the cycle time;
        `counter_errors`, lost and repeated frames since the start. None before the second is over.
        """
        if self._row_ns is None or now_ns - self._row_ns < NS_PER_S:
            return None
        seconds = (now_ns - self._row_ns) / NS_PER_S
        heard = {name: count for name, count in self.heard.items() if count.frames}
        row = {
            "frames_per_second": {n: (c.frames - c.frames_before) / seconds for n, c in heard.items()},
            "longest_interval": {
                name: 100.0 * count.longest_ns / count.codec.cycle_ns
                for name, count in heard.items()
                if count.codec.cycle_ns and count.longest_ns
            },
            "shortest_interval": {
                name: 100.0 * count.shortest_ns / count.codec.cycle_ns
                for name, count in heard.items()
                if count.codec.cycle_ns and count.shortest_ns is not None
            },
            "counter_errors": {
                name: float(count.lost + count.repeated)
                for name, count in heard.items()
                if count.codec.protection
            },
        }
        for count in heard.values():
            count.frames_before, count.longest_ns, count.shortest_ns = count.frames, 0, None
        self._row_ns = now_ns
        return row

    @staticmethod
    def _count_gaps(heard: _Heard, counters: NDArray[np.int64]) -> None:
        before = counters[0] - 1 if heard.last_counter is None else heard.last_counter
        steps = np.diff(counters, prepend=before) % COUNTER_MODULUS
        heard.repeated += int(np.count_nonzero(steps == 0))
        heard.lost += int(np.sum(steps[steps > 1] - 1))
        heard.last_counter = int(counters[-1])


def _part(block: Block, begin: int, end: int) -> Block:
    """Frames `begin` to `end` of a block."""
    if begin == 0 and end == len(block):
        return block
    messages = {}
    for name, message in block.messages.items():
        first, last = np.searchsorted(message.rows, (begin, end)).tolist()
        if last > first:
            rows = message.rows[first:last] - begin
            messages[name] = MessageBlock(message.codec, rows, message.values[first:last])
    return Block(block.stamps_ns[begin:end], messages, {}, {})
