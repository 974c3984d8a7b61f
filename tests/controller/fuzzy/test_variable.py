from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skfuzzy import trapmf

from controller.fuzzy.membership import RuleBaseError, Trapezoid, left_shoulder, right_shoulder, triangle
from controller.fuzzy.variable import FIVE_TERMS, Variable

SIGNED = st.floats(-10, 10).map(lambda x: round(x, 3))


@given(corners=st.lists(SIGNED, min_size=4, max_size=4), value=SIGNED)
def test_grade_is_scikit_fuzzys_for_every_trapezoid(corners, value):
    corners = sorted(corners)
    if corners[0] == corners[-1]:
        with pytest.raises(RuleBaseError, match="leave no width"):
            Trapezoid(*corners)
        return
    for x in (value, *corners):
        expected = trapmf(np.array([x]), np.array(corners))[0]
        assert Trapezoid(*corners).grade(x) == pytest.approx(expected, abs=1e-12)


def test_shoulders_go_on_for_ever():
    assert left_shoulder(1.0, 2.0).grade(-1e300) == 1.0
    assert left_shoulder(1.0, 2.0).grade(1.25) == 0.75
    assert right_shoulder(1.0, 2.0).grade(1e300) == 1.0
    assert right_shoulder(1.0, 2.0).grade(1.25) == 0.25


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        ((0, 2, 1, 3), "0, 2, 1, 3 must ascend"),
        ((0, math.nan, 1, 3), "must ascend"),
        ((-math.inf, 0, 1, 3), "both infinite on the side of a shoulder"),
        ((0, 1, 2, math.inf), "both infinite on the side of a shoulder"),
        ((-math.inf, -math.inf, math.inf, math.inf), "true everywhere"),
        ((math.inf,) * 4, "leave no width"),
    ],
)
def test_corners_that_make_no_shape_are_rejected(corners, message):
    with pytest.raises(RuleBaseError, match=message):
        Trapezoid(*corners)


def test_triangles_reach_zero_at_the_neighbours_peaks():
    variable = Variable.symmetric("e", "m/s", FIVE_TERMS, (0.5, 1.0))
    assert variable.corners("NB") == (-1.0, -1.0, -1.0, -0.5)
    assert variable.corners("Z") == (-0.5, 0.0, 0.0, 0.5)
    assert variable.corners("PB") == (0.5, 1.0, 1.0, 1.0)


@given(value=st.floats(-3, 3))
def test_grades_of_a_partition_sum_to_one(value):
    variable = Variable.symmetric("e", "m/s", FIVE_TERMS, (0.3, 1.0))
    assert sum(variable.grades(value)) == pytest.approx(1.0, abs=1e-12)


def test_peaks_of_shapes_are_the_middles_of_their_plateaus_inside_the_universe():
    variable = Variable.shaped(
        "u",
        "1",
        (-2.0, 3.0),
        {
            "N": left_shoulder(-1.0, 0.0),
            "Z": Trapezoid(-1.0, 0.0, 1.0, 2.0),
            "P": right_shoulder(0.5, 2.0),
        },
    )
    assert variable.peaks == (-1.5, 0.5, 2.5)
    assert variable.corners("P") == (0.5, 2.0, 3.0, 3.0)


@pytest.mark.parametrize(
    ("peaks", "message"),
    [
        ((0.0, 1.0), "term Z: peak 0 must be greater than -0, the peak of NS"),
        ((1.0, 0.5), "term NS: peak -1 must be greater than -0.5, the peak of NB"),
        ((0.5, float("nan")), "must be finite"),
        ((0.5, float("inf")), "must be finite"),
    ],
)
def test_peaks_that_do_not_ascend_or_are_not_finite_are_rejected(peaks, message):
    with pytest.raises(RuleBaseError, match=message) as error:
        Variable.symmetric("error", "m/s", FIVE_TERMS, peaks)
    assert error.value.exit_code == 2
    assert "\n" not in str(error.value)


def test_a_term_without_a_peak_is_rejected():
    with pytest.raises(RuleBaseError, match="5 terms but 2 peaks"):
        Variable("error", "m/s", FIVE_TERMS, (0.0, 1.0))


def test_a_term_named_twice_is_rejected():
    with pytest.raises(RuleBaseError, match="named twice"):
        Variable("error", "m/s", ("N", "N"), (0.0, 1.0))


@pytest.mark.parametrize(
    ("shapes", "universe", "message"),
    [
        ({"N": left_shoulder(0, 1), "P": right_shoulder(0, 1)}, (1.0, -1.0), "finite, ascending values"),
        ({"N": left_shoulder(0, 1), "P": right_shoulder(0, 1)}, (-1.0, math.inf), "two finite"),
        ({"N": triangle(0, 1, 2), "P": triangle(-1, 1.5, 2)}, (0.0, 2.0), "term P: its membership function"),
        ({"N": triangle(0, 1, 2), "P": triangle(1, 3, 4)}, (0.0, 2.0), "term P: peak 2.5 lies outside"),
    ],
)
def test_shapes_out_of_order_or_out_of_the_universe_are_rejected(shapes, universe, message):
    with pytest.raises(RuleBaseError, match=message):
        Variable.shaped("u", "1", universe, shapes)


def test_a_number_of_shapes_other_than_of_terms_is_rejected():
    with pytest.raises(RuleBaseError, match="1 membership functions for 2 terms"):
        Variable("u", "1", ("N", "P"), (0.0, 1.0), (triangle(0, 1, 2),))
