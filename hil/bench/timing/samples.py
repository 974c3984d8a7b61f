"""What a slice measured, and what slices say together: percentiles, histograms, ratios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.bench.timing.misses import Miss

__all__ = ["Measured", "Slice", "Spread", "histogram", "merged", "ratio", "spread"]

Array = NDArray[np.float64]
EMPTY: Array = np.empty(0)


@dataclass(frozen=True)
class Spread:
    """A distribution in a few figures, us. Percentiles are values that occurred, not interpolated ones."""

    count: int
    min: float
    mean: float
    p50: float
    p99: float
    p999: float
    max: float

    def as_dict(self) -> dict[str, float]:
        """Ready for JSON, rounded to the nanosecond."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


@dataclass(frozen=True)
class Slice:
    """One slice of one part. Arrays are (n), in us; what the part does not have is empty.

    `period_error_us`: distance between two wake-ups minus the distance between their deadlines.
    `spans_us`: the execution split by name. `cpu_share`: of one CPU, by process. `missed`: deadlines missed,
    by process; `misses`: each with what the witness saw.
    """

    wakeup_latency_us: Array
    period_error_us: Array = field(default_factory=lambda: EMPTY)
    spans_us: Mapping[str, Array] = field(default_factory=dict)
    execution_us: Array = field(default_factory=lambda: EMPTY)
    signal_age_us: Array = field(default_factory=lambda: EMPTY)
    command_latency_us: Array = field(default_factory=lambda: EMPTY)
    plant_latency_us: Array = field(default_factory=lambda: EMPTY)
    cpu_share: Mapping[str, float] = field(default_factory=dict)
    missed: Mapping[str, int] = field(default_factory=dict)
    misses: Sequence[Miss] = ()
    witnessed: bool = False
    frames_lost: int = 0
    rights: Mapping[str, Any] = field(default_factory=dict)
    series_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))


@dataclass(frozen=True)
class Measured:
    """All slices of one part under one condition, as one."""

    part: str
    condition: str
    slices: Sequence[Slice]

    def values(self, name: str) -> Array:
        """One quantity of all slices in a row, us."""
        return np.concatenate([getattr(piece, name) for piece in self.slices] or [EMPTY])

    @property
    def wakeup_latency_us(self) -> Array:
        """Wake-up latency of every cycle."""
        return self.values("wakeup_latency_us")

    def spans_us(self) -> dict[str, Array]:
        """The execution split: read, step, …, each of every cycle."""
        names = list(self.slices[0].spans_us) if self.slices else []
        return {name: np.concatenate([piece.spans_us[name] for piece in self.slices]) for name in names}

    def cpu_share(self) -> dict[str, float]:
        """Mean share of one CPU, by process."""
        names = {name for piece in self.slices for name in piece.cpu_share}
        return {
            name: float(np.mean([p.cpu_share[name] for p in self.slices if name in p.cpu_share]))
            for name in sorted(names)
        }

    def missed(self) -> dict[str, int]:
        """Deadlines missed, by process."""
        names = {name for piece in self.slices for name in piece.missed}
        return {name: sum(p.missed.get(name, 0) for p in self.slices) for name in sorted(names)}

    def misses(self) -> list[Miss]:
        """Every miss with what the witness saw."""
        return [miss for piece in self.slices for miss in piece.misses]

    @property
    def witnessed(self) -> bool:
        """Whether a witness ran during all of it."""
        return bool(self.slices) and all(piece.witnessed for piece in self.slices)

    @property
    def unseen(self) -> int | None:
        """Missed deadlines that the witness saw no reason for; None without a witness."""
        return sum(miss.missed for miss in self.misses() if not miss.seen) if self.witnessed else None

    @property
    def sched_fifo(self) -> bool:
        """Whether every process of it had SCHED_FIFO."""
        return bool(self.slices) and all(bool(piece.rights.get("sched_fifo")) for piece in self.slices)


def median_of_slices(known: Measured, quantity: str, percentile: str) -> float | None:
    """A percentile of one quantity in each slice, and of those the median, us; None without a cycle.

    For parts of one run that are to be compared when neither costs more: what a hypervisor does once a minute
    falls into slices of one part or the other by chance, and would decide over the percentile of them all.
    """
    each = [getattr(one, percentile) for piece in known.slices if (one := spread(getattr(piece, quantity)))]
    return float(np.median(each)) if each else None


def merged(slices: Mapping[tuple[str, str], Sequence[Slice]]) -> dict[tuple[str, str], Measured]:
    """(condition, part) -> slices, as (condition, part) -> all of them as one."""
    return {key: Measured(key[1], key[0], pieces) for key, pieces in slices.items() if pieces}


def spread(values_us: Array) -> Spread | None:
    """Percentiles of a distribution (nearest rank, as cyclictest's histogram gives them); None if empty."""
    if not len(values_us):
        return None
    ordered = np.sort(values_us)
    count = len(ordered)
    # Ranks in whole numbers: in floating point 99.9 % of 1000 is a little more than 999.
    p50, p99, p999 = (float(ordered[-(-count * per_mille // 1000) - 1]) for per_mille in (500, 990, 999))
    return Spread(count, float(ordered[0]), float(np.mean(ordered)), p50, p99, p999, float(ordered[-1]))


def ratio(ours: Spread | None, peer: Spread | None, name: str) -> float | None:
    """Ours over the peer's, for `p50`, `p99`, `p999` or `max`; None if one is missing or the peer's is 0."""
    if ours is None or peer is None or not getattr(peer, name):
        return None
    return float(getattr(ours, name) / getattr(peer, name))


def histogram(values_us: Array) -> dict[int, int]:
    """Whole microseconds -> cycles, as cyclictest counts them (rounded down); no empty bins."""
    bins, counts = np.unique(np.floor(values_us).astype(np.int64), return_counts=True)
    return dict(zip(bins.tolist(), counts.tolist(), strict=True))


def from_histogram(counts: Mapping[int, int], *, overflows: int = 0, maximum_us: float = 0.0) -> Array:
    """The values that a histogram stands for; what overflowed counts as the maximum."""
    bins = np.array(sorted(counts), np.float64)
    values = np.repeat(bins, [counts[int(us)] for us in bins])
    return np.concatenate((values, np.full(max(0, overflows), maximum_us)))
