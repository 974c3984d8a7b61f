"""The arithmetic of a compiled rule base, as kernels that other compiled code may call.

`infer(error, rate, *arguments)` is one evaluation; `CompiledRuleBase.arguments` are its arguments. All
arrays come in as arguments, so that the compiled code can be cached and serves every rule base. `strengths`
and `work` are scratch that an evaluation overwrites: two threads must not share them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

DISCRETE, CONTINUOUS, CENTRES = 0, 1, 2

CORNERS_PER_TERM = 4


@njit(cache=True)
def infer(
    error: float,
    rate: float,
    limits: Floats,
    error_shapes: Floats,
    rate_shapes: Floats,
    consequents: Integers,
    output_shapes: Floats,
    points: Floats,
    memberships: Floats,
    strengths: Floats,
    work: Floats,
    product: bool,
    method: int,
) -> float:
    """Output for one pair of inputs; NaN for a non-finite input, never a plausible number.

    `limits`: low and high of error, rate and output. `*_shapes[term]`: the four corners; for the output the
    centre stands fifth. `consequents[rate term, error term]`: output term, -1 no rule. `points`,
    `memberships[point, output term]`: of the discrete centroid. Leaves each rule's strength in `strengths`.
    """
    if not (math.isfinite(error) and math.isfinite(rate)):
        return math.nan
    error = min(max(error, limits[0]), limits[1])
    rate = min(max(rate, limits[2]), limits[3])
    terms = output_shapes.shape[0]
    heights = work[:terms]
    heights[:] = 0.0
    error_grades = work[terms : terms + error_shapes.shape[0]]
    for j in range(error_shapes.shape[0]):
        error_grades[j] = _grade(error, error_shapes[j])
    moment = 0.0
    weight = 0.0
    for i in range(rate_shapes.shape[0]):
        rate_grade = _grade(rate, rate_shapes[i])
        for j in range(error_shapes.shape[0]):
            grade = rate_grade * error_grades[j] if product else min(rate_grade, error_grades[j])
            term = consequents[i, j]
            if term < 0:
                grade = 0.0
            strengths[i, j] = grade
            if grade > 0.0:
                moment += grade * output_shapes[term, 4]
                weight += grade
                heights[term] = max(heights[term], grade)
    if weight == 0.0:
        return math.nan
    if method == CENTRES:
        return moment / weight
    if method == DISCRETE:
        centroid: float = _discrete_centroid(heights, points, memberships)
    else:
        centroid = _continuous_centroid(heights, output_shapes, limits[4], limits[5], work[terms:])
    return centroid


@njit(cache=True)
def infer_array(
    errors: Floats,
    rates: Floats,
    outputs: Floats,
    limits: Floats,
    error_shapes: Floats,
    rate_shapes: Floats,
    consequents: Integers,
    output_shapes: Floats,
    points: Floats,
    memberships: Floats,
    strengths: Floats,
    work: Floats,
    product: bool,
    method: int,
) -> None:
    """`infer` for each pair of two equally long arrays."""
    for n in range(errors.shape[0]):
        outputs[n] = infer(
            errors[n],
            rates[n],
            limits,
            error_shapes,
            rate_shapes,
            consequents,
            output_shapes,
            points,
            memberships,
            strengths,
            work,
            product,
            method,
        )


def work_length(error_terms: int, output_terms: int) -> int:
    """How many numbers of scratch `infer` needs."""
    return output_terms + max(error_terms, CORNERS_PER_TERM * output_terms + 2 * output_terms)


@njit(cache=True)
def _grade(value: float, corners: Floats) -> float:
    if corners[1] <= value <= corners[2]:
        return 1.0
    if value <= corners[0] or value >= corners[3]:
        return 0.0
    if value < corners[1]:
        grade: float = (value - corners[0]) / (corners[1] - corners[0])
    else:
        grade = (corners[3] - value) / (corners[3] - corners[2])
    return grade


@njit(cache=True)
def _discrete_centroid(heights: Floats, points: Floats, memberships: Floats) -> float:
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
def _continuous_centroid(heights: Floats, shapes: Floats, low: float, high: float, work: Floats) -> float:
    """Centroid of the greatest of the cut trapezoids, integrated piece by piece.

    Between two neighbouring corners of the cut trapezoids each of them is a straight line. Their upper
    envelope starts with the highest line and changes at each crossing to a steeper one: no crossing can be
    missed and none met twice, whatever the rounding.
    """
    terms = heights.shape[0]
    corners = work[: CORNERS_PER_TERM * terms]
    count = 0
    for k in range(terms):
        if heights[k] > 0.0:
            rise = heights[k] * (shapes[k, 1] - shapes[k, 0])
            fall = heights[k] * (shapes[k, 3] - shapes[k, 2])
            for corner in (shapes[k, 0], shapes[k, 0] + rise, shapes[k, 3] - fall, shapes[k, 3]):
                _insert(min(max(corner, low), high), corners, count)
                count += 1
    starts = work[CORNERS_PER_TERM * terms : CORNERS_PER_TERM * terms + terms]
    slopes = work[CORNERS_PER_TERM * terms + terms : CORNERS_PER_TERM * terms + 2 * terms]
    moment = 0.0
    area = 0.0
    for n in range(count - 1):
        left, right = corners[n], corners[n + 1]
        if right <= left:
            continue
        line = -1
        for k in range(terms):
            if heights[k] > 0.0:
                starts[k], slopes[k] = _line(left, right, heights[k], shapes[k])
                if (
                    line < 0
                    or starts[k] > starts[line]
                    or (starts[k] == starts[line] and slopes[k] > slopes[line])
                ):
                    line = k
        x = left
        while x < right:
            y = starts[line] + slopes[line] * (x - left)
            until = right
            steeper = -1
            for k in range(terms):
                if heights[k] > 0.0 and slopes[k] > slopes[line]:
                    ahead = y - (starts[k] + slopes[k] * (x - left))
                    crossing = x + max(ahead, 0.0) / (slopes[k] - slopes[line])
                    if crossing < until or (
                        crossing == until and steeper >= 0 and slopes[k] > slopes[steeper]
                    ):
                        until = crossing
                        steeper = k
            end = starts[line] + slopes[line] * (until - left)
            width = until - x
            area += 0.5 * width * (y + end)
            moment += width * (x * (2.0 * y + end) + until * (y + 2.0 * end)) / 6.0
            x = until
            if steeper < 0:
                break
            line = steeper
    return moment / area if area > 0.0 else math.nan


@njit(cache=True)
def _line(left: float, right: float, height: float, corners: Floats) -> tuple[float, float]:
    """A cut trapezoid between two neighbouring corners: its value at the left one, and its slope."""
    middle = 0.5 * (left + right)
    if middle <= corners[0] or middle >= corners[3]:
        return 0.0, 0.0
    if middle < corners[1]:
        width = corners[1] - corners[0]
        if middle - corners[0] < height * width:
            return (left - corners[0]) / width, 1.0 / width
    elif middle > corners[2]:
        width = corners[3] - corners[2]
        if corners[3] - middle < height * width:
            return (corners[3] - left) / width, -1.0 / width
    return height, 0.0


@njit(cache=True)
def _insert(value: float, ordered: Floats, count: int) -> None:
    k = count
    while k > 0 and ordered[k - 1] > value:
        ordered[k] = ordered[k - 1]
        k -= 1
    ordered[k] = value
