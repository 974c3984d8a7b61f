"""The compiled form of a rule base: one call of well under 10 us, no allocation, no state.

The readable definition is :mod:`controller.fuzzy.rulebase`; tests prove the two equal on
scikit-fuzzy's membership functions with the same discrete centroid.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.fuzzy.rulebase import RuleBase

Floats = NDArray[np.float64]


class CompiledRuleBase:
    """Evaluates one rule base: `compiled(error, rate) -> output`, in the units of its variables.

    Finite inputs outside the universe are clipped to it. A non-finite input raises ValueError: a lost
    sensor must not turn into a plausible command.
    """

    def __init__(self, rules: RuleBase) -> None:
        self.rules = rules
        peaks = np.array(rules.output.peaks)
        points = np.array(rules.universe())
        self._arguments = (
            np.array(rules.error.peaks),
            np.array(rules.rate.peaks),
            np.array(rules.consequents, dtype=np.int64),
            points,
            _memberships(points, peaks),
            np.zeros(len(peaks)),
        )

    def __call__(self, error: float, rate: float) -> float:
        """Output for a speed error and its rate."""
        if not (math.isfinite(error) and math.isfinite(rate)):
            raise ValueError(f"fuzzy input not finite: error {error}, rate {rate}")
        return float(infer(error, rate, *self._arguments))


@njit(cache=True)
def infer(
    error: float,
    rate: float,
    error_peaks: Floats,
    rate_peaks: Floats,
    consequents: NDArray[np.int64],
    points: Floats,
    memberships: Floats,
    heights: Floats,
) -> float:
    """Mamdani inference with min, max and the discrete centroid (Fuzzy-D paper, section on the FLC).

    `consequents[rate term, error term]` is an output term; `memberships[point, output term]` its
    triangle at each of `points`; `heights` is scratch space of one value for each output term.
    """
    error_term, error_upper = _locate(error, error_peaks)
    rate_term, rate_upper = _locate(rate, rate_peaks)
    heights[:] = 0.0
    for i in range(2):
        rate_grade = rate_upper if i == 1 else 1.0 - rate_upper
        for j in range(2):
            error_grade = error_upper if j == 1 else 1.0 - error_upper
            grade = min(rate_grade, error_grade)
            term = consequents[rate_term + i, error_term + j]
            heights[term] = max(heights[term], grade)
    moment = 0.0
    area = 0.0
    for n in range(points.shape[0]):
        grade = 0.0
        for term in range(heights.shape[0]):
            grade = max(grade, min(heights[term], memberships[n, term]))
        moment += points[n] * grade
        area += grade
    return moment / area


@njit(cache=True)
def _locate(value: float, peaks: Floats) -> tuple[int, float]:
    """Term left of the clipped value, and the grade of the term right of it."""
    last = peaks.shape[0] - 1
    if value <= peaks[0]:
        return 0, 0.0
    if value >= peaks[last]:
        return last - 1, 1.0
    term = 0
    while value >= peaks[term + 1]:
        term += 1
    return term, (value - peaks[term]) / (peaks[term + 1] - peaks[term])


def _memberships(points: Floats, peaks: Floats) -> Floats:
    """Grade of each output term (columns) at each point (rows)."""
    columns = []
    for k in range(len(peaks)):
        unit = np.zeros(len(peaks))
        unit[k] = 1.0
        columns.append(np.interp(points, peaks, unit))
    return np.ascontiguousarray(np.stack(columns, axis=1))
