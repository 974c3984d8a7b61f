"""Statistics of many runs of one contender. A run that never stood still counts as an infinite stop error."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hil.bench.metrics import Array
from hil.bench.trial import TrialResult


@dataclass(frozen=True)
class Spread:
    """Percentiles are nearest-rank: values that a run really had. `inf` where so many runs gave no value."""

    runs: int
    failed: int
    no_stop: int
    """Of the failed ones: the train never stood, or there was no run at all."""
    stop_p95_m: float
    stop_p99_m: float
    stop_worst_m: float
    worst_draw: int
    rms_p95_mps: float
    rms_worst_mps: float
    max_error_p95_mps: float
    jerk_p95_mps3: float
    jerk_worst_mps3: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON, which knows no infinity: null."""
        return {key: None if is_unknown(value) else value for key, value in asdict(self).items()}


def is_unknown(value: float) -> bool:
    """Whether a statistic is infinite because runs gave no value."""
    return isinstance(value, float) and not math.isfinite(value)


def spread(results: Sequence[TrialResult]) -> Spread:
    """Statistics over the drawn runs of one contender, at least one; errors count whatever their sign."""
    stops = _values(results, lambda result: result.metrics.stop_error_m)
    rms = _values(results, lambda result: result.metrics.rms_speed_error_mps)
    errors = _values(results, lambda result: result.metrics.max_speed_error_mps)
    jerks = _values(results, lambda result: result.metrics.max_jerk_mps3)
    return Spread(
        runs=len(results),
        failed=sum(bool(result.failure) for result in results),
        no_stop=int(np.sum(np.isinf(stops))),
        stop_p95_m=percentile(stops, 95),
        stop_p99_m=percentile(stops, 99),
        stop_worst_m=float(np.max(stops)),
        worst_draw=results[int(np.argmax(stops))].draw.number,
        rms_p95_mps=percentile(rms, 95),
        rms_worst_mps=float(np.max(rms)),
        max_error_p95_mps=percentile(errors, 95),
        jerk_p95_mps3=percentile(jerks, 95),
        jerk_worst_mps3=float(np.max(jerks)),
    )


def percentile(values: Array, percent: float) -> float:
    """The smallest value that at least `percent` of them do not exceed."""
    return float(np.percentile(values, percent, method="inverted_cdf"))


def _values(results: Iterable[TrialResult], value: Callable[[TrialResult], float | None]) -> Array:
    return np.array([math.inf if (v := value(result)) is None else abs(v) for result in results])
