"""What the compiled rule base is judged by: scikit-fuzzy. Never in a loop; imported only when asked for.

Two oracles, because scikit-fuzzy's control system computes only one thing:

`reference` is exact for every declaration. It takes scikit-fuzzy's membership functions (`trapmf`, `trimf`,
`interp_membership`) and its polygon centroid (`defuzz`), and does the rest in plain numpy: the discrete
centroid as the two sums, the centre average as the two sums, and the continuous centroid as the polygon
through *every* corner of the aggregate, the crossings between cut terms included.

`skfuzzy_system` is scikit-fuzzy's own control system, built from the declaration. Its `centroid` is the exact
centroid of a polygon, but of one drawn through samples: it knows a membership function at the points of the
universe only and joins them by straight lines, adds the points where a term is cut, and leaves out the
crossings between different terms. Therefore:

- it is the peer of `ContinuousCentroid` only. A discrete centroid over the same points is another number
  (up to 1.9 % of the largest output apart for the Fuzzy-D paper's sets at 101 points), a centre average a
  third;
- the corners of all membership functions must be among the points, of inputs as well as of the output, or
  it would round peaks off: the points are spread evenly between each two neighbouring corners here;
- what remains are the crossings: an error of second order in the spacing, at 1001 points below 1e-5 of the
  output's range for the rule bases of the laws. (Spread evenly over the whole universe they would leave 2e-5
  with the sets fitted to the Fuzzy-D paper, where two peaks stand 0.8 % of the range apart.)
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.fuzzy.rulebase import CentreAverage, DiscreteCentroid, RuleBase, RuleBaseError
from controller.fuzzy.variable import Variable

Floats = NDArray[np.float64]


def skfuzzy_system(rules: RuleBase, points: int = 1001) -> Any:
    """A `skfuzzy.control.ControlSystem` of the same variables (by name), terms and rules.

    Whatever the declared defuzzification, it computes scikit-fuzzy's centroid: see the module docstring.
    RuleBaseError for two variables of one name, which scikit-fuzzy would silently take for one.
    """
    from skfuzzy import control

    names = [v.name for v in (rules.error, rules.rate, rules.output)]
    if len(set(names)) != len(names):
        raise RuleBaseError(f"scikit-fuzzy needs three different variable names, not {', '.join(names)}")
    conjunction = np.multiply if rules.conjunction == "product" else np.fmin
    made = []
    for variable, kind in (
        (rules.error, control.Antecedent),
        (rules.rate, control.Antecedent),
        (rules.output, control.Consequent),
    ):
        universe = universe_with_corners(variable, points)
        made.append(kind(universe, variable.name))
        for term in variable.terms:
            made[-1][term] = grades(variable, term, universe)
    error, rate, output = made
    return control.ControlSystem(
        [
            control.Rule(error[e] & rate[r], output[rules.output.terms[term]], and_func=conjunction)
            for r, row in zip(rules.rate.terms, rules.consequents, strict=True)
            for e, term in zip(rules.error.terms, row, strict=True)
            if term >= 0
        ]
    )


def reference(rules: RuleBase, error: float, rate: float) -> float:
    """The declared output, from scikit-fuzzy's membership functions; slow, exact, independent of the kernel.

    ValueError for a non-finite input.
    """
    if not (math.isfinite(error) and math.isfinite(rate)):
        raise ValueError(f"fuzzy input not finite: error {error}, rate {rate}")
    of_error, of_rate = _input_grades(rules.error, error), _input_grades(rules.rate, rate)
    strengths = np.outer(of_rate, of_error)
    if rules.conjunction == "min":
        strengths = np.minimum(of_rate[:, None], of_error[None, :])
    consequents = np.array(rules.consequents)
    strengths = np.where(consequents >= 0, strengths, 0.0)
    if isinstance(rules.defuzzification, CentreAverage):
        return float(np.sum(strengths * np.array(rules.output.peaks)[consequents]) / np.sum(strengths))
    heights = {
        term: float(np.max(strengths[consequents == k], initial=0.0))
        for k, term in enumerate(rules.output.terms)
    }
    if isinstance(rules.defuzzification, DiscreteCentroid):
        points = np.array(rules.sample())
        aggregate = _aggregate(rules.output, heights, points)
        return float(np.sum(points * aggregate) / np.sum(aggregate))
    from skfuzzy import defuzz

    points = _every_corner(rules.output, heights)
    return float(defuzz(points, _aggregate(rules.output, heights, points), "centroid"))


def grades(variable: Variable, term: str, values: Floats) -> Floats:
    """Membership of values inside the universe, by scikit-fuzzy's `trapmf`."""
    from skfuzzy import trapmf

    found: Floats = trapmf(np.asarray(values, np.float64), np.array(variable.corners(term)))
    return found


def universe_with_corners(variable: Variable, points: int) -> Floats:
    """`points` points: the corners, and as many between each two; an upright edge takes one more."""
    low, high = variable.low, variable.high
    corners = np.unique(
        [low, high, *(x for t in variable.terms for x in variable.corners(t) if low < x < high)]
    )
    steps = np.diff(np.linspace(0, max(points, len(corners)) - 1, len(corners)).round().astype(int))
    between = [
        np.linspace(start, end, step, endpoint=False)
        for start, end, step in zip(corners[:-1], corners[1:], steps, strict=True)
    ]
    return _inside(variable, [*np.concatenate(between), *_corners(variable)])


def _input_grades(variable: Variable, value: float) -> Floats:
    """By `interp_membership` through the corners, where that is exact: at no upright edge."""
    from skfuzzy import interp_membership

    universe = _inside(variable, _corners(variable))
    value = variable.clip(value)
    return np.array(
        [interp_membership(universe, grades(variable, term, universe), value) for term in variable.terms]
    )


def _corners(variable: Variable) -> list[float]:
    found = []
    for term in variable.terms:
        left, top_left, top_right, right = variable.corners(term)
        found += [left, top_left, top_right, right]
        if left == top_left:
            found.append(np.nextafter(left, -math.inf))
        if right == top_right:
            found.append(np.nextafter(right, math.inf))
    return found


def _aggregate(output: Variable, heights: dict[str, float], points: Floats) -> Floats:
    cut = [np.minimum(heights[term], grades(output, term, points)) for term in output.terms]
    found: Floats = np.max(cut, axis=0)
    return found


def _every_corner(output: Variable, heights: dict[str, float]) -> Floats:
    """Corners of the cut terms and, between these, the crossings of their then straight lines."""
    corners = _corners(output)
    for term in output.terms:
        left, top_left, top_right, right = output.corners(term)
        corners.append(left + heights[term] * (top_left - left))
        corners.append(right - heights[term] * (right - top_right))
    points = _inside(output, corners)
    cut = [np.minimum(heights[term], grades(output, term, points)) for term in output.terms]
    crossings = [np.empty(0)]
    for one, other in combinations(cut, 2):
        apart = one - other
        k = np.flatnonzero(apart[:-1] * apart[1:] < 0.0)
        share = apart[k] / (apart[k] - apart[k + 1])
        crossings.append(points[k] + share * (points[k + 1] - points[k]))
    return _inside(output, [*points, *np.concatenate(crossings)])


def _inside(variable: Variable, values: list[float]) -> Floats:
    found = np.unique(np.asarray([variable.low, variable.high, *values], np.float64))
    return found[(found >= variable.low) & (found <= variable.high)]
