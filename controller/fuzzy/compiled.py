"""The compiled form of a rule base: one call of a few microseconds, no allocation that grows.

The readable definition is :mod:`controller.fuzzy.rulebase`; tests prove the two equal on scikit-fuzzy's
membership functions, for every defuzzification.

A study that steps far below a millisecond calls the kernel from its own compiled loop, with the same numbers:

    from controller.fuzzy.kernel import infer

    @njit(cache=True)
    def simulate(steps, dt_s, arguments):
        ...
        demand = infer(error, rate, *arguments)      # NaN for a non-finite input

    simulate(580_000, 0.00025, CompiledRuleBase(rules).arguments)

(numba's cache of such a loop notices a change of its own file only: after a change of the kernel, delete it.)
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from controller.fuzzy.kernel import (
    CENTRES,
    CONTINUOUS,
    DISCRETE,
    Floats,
    Integers,
    infer,
    infer_array,
    work_length,
)
from controller.fuzzy.rulebase import CentreAverage, ContinuousCentroid, RuleBase
from controller.fuzzy.variable import Variable

Arguments = tuple[Floats, Floats, Floats, Integers, Floats, Floats, Floats, Floats, Floats, bool, int]


class CompiledRuleBase:
    """Evaluates one rule base: `compiled(error, rate) -> output`, in the units of its variables.

    Finite inputs outside the universe are clipped to it: `clipped` counts them and `is_clipping` tells of
    the last evaluation. A non-finite input raises ValueError: a lost sensor must not turn into a plausible
    command. Nothing else of an evaluation is remembered. One instance serves one thread.
    """

    clipped: int
    """How many inputs were outside their universe, since the start or `reset`."""
    is_clipping: bool
    """Whether an input of the last evaluation was outside."""
    arguments: Arguments
    """What follows `error, rate` in a call of `controller.fuzzy.kernel.infer`."""

    def __init__(self, rules: RuleBase) -> None:
        self.rules = rules
        self._low_error, self._high_error = rules.error.low, rules.error.high
        self._low_rate, self._high_rate = rules.rate.low, rules.rate.high
        points = np.array(rules.sample(), dtype=np.float64)
        grades = [[shape.grade(z) for shape in rules.output.shapes] for z in points]
        terms = len(rules.output.terms)
        output = np.column_stack((_corners(rules.output), np.array(rules.output.peaks)))
        method = DISCRETE
        if isinstance(rules.defuzzification, ContinuousCentroid):
            method = CONTINUOUS
        elif isinstance(rules.defuzzification, CentreAverage):
            method = CENTRES
        self.arguments = (
            np.array([x for v in (rules.error, rules.rate, rules.output) for x in (v.low, v.high)]),
            _corners(rules.error),
            _corners(rules.rate),
            np.array(rules.consequents, dtype=np.int64),
            np.ascontiguousarray(output),
            points,
            np.array(grades, dtype=np.float64).reshape(len(points), terms),
            np.zeros((len(rules.rate.terms), len(rules.error.terms))),
            np.zeros(work_length(len(rules.error.terms), terms)),
            rules.conjunction == "product",
            method,
        )
        self._strengths = self.arguments[7]
        # Compiled (or read from numba's cache) here, not in the first cycle of a loop.
        infer(self._low_error, self._low_rate, *self.arguments)
        self.reset()

    def reset(self) -> None:
        """Start counting clipped inputs anew."""
        self.clipped = 0
        self.is_clipping = False

    def __call__(self, error: float, rate: float) -> float:
        """Output for an error and its rate."""
        output: float = infer(float(error), float(rate), *self.arguments)
        if math.isnan(output):
            raise _refused(error, rate)
        inside = self._low_error <= error <= self._high_error and self._low_rate <= rate <= self._high_rate
        self.is_clipping = not inside
        if not inside:
            self.clipped += not self._low_error <= error <= self._high_error
            self.clipped += not self._low_rate <= rate <= self._high_rate
        return output

    def array(self, errors: ArrayLike, rates: ArrayLike) -> Floats:
        """Outputs for arrays of errors and rates, broadcast against each other; counts and raises alike."""
        error, rate = np.broadcast_arrays(np.asarray(errors, np.float64), np.asarray(rates, np.float64))
        outputs = np.empty(error.shape)
        flat = outputs.reshape(-1)
        # ravel copies what broadcasting made: the kernel wants plain arrays.
        infer_array(np.array(error).ravel(), np.array(rate).ravel(), flat, *self.arguments)
        bad = np.flatnonzero(np.isnan(flat))
        if bad.size:
            raise _refused(float(error.flat[bad[0]]), float(rate.flat[bad[0]]))
        outside = [
            (error < self._low_error) | (error > self._high_error),
            (rate < self._low_rate) | (rate > self._high_rate),
        ]
        self.clipped += int(sum(np.count_nonzero(each) for each in outside))
        self.is_clipping = bool(flat.size) and any(bool(each.flat[-1]) for each in outside)
        return outputs

    def activations(self, error: float, rate: float) -> Floats:
        """Strength of every rule, shaped (rate terms, error terms), for display; 0 where there is no rule.

        Counts no clipped input.
        """
        if math.isnan(infer(float(error), float(rate), *self.arguments)):
            raise _refused(error, rate)
        return self._strengths.copy()


def _refused(error: float, rate: float) -> ValueError:
    if math.isfinite(error) and math.isfinite(rate):
        return ValueError(f"no rule fires: error {error}, rate {rate}")
    return ValueError(f"fuzzy input not finite: error {error}, rate {rate}")


def _corners(variable: Variable) -> Floats:
    return np.array([variable.corners(term) for term in variable.terms], dtype=np.float64)
