from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from controller.fuzzy.bases import fsmc_rules
from controller.fuzzy.coverage import no_rule_fires, pieces, uncovered
from controller.fuzzy.membership import Trapezoid, left_shoulder, right_shoulder, triangle
from controller.fuzzy.rulebase import RuleBase, RuleBaseError
from controller.fuzzy.variable import Variable


def variable(*shapes: Trapezoid, universe=(-1.0, 1.0)) -> Variable:
    return Variable.shaped("error", "m/s", universe, {f"T{k}": shape for k, shape in enumerate(shapes)})


def test_a_gap_between_two_terms_is_found_with_its_ends():
    assert uncovered(variable(left_shoulder(-1, -0.2), right_shoulder(0.3, 1))) == (-0.2, 0.3)


def test_a_gap_far_narrower_than_any_sampling_is_found():
    assert uncovered(variable(left_shoulder(-1, 0), right_shoulder(1e-9, 1))) == (0.0, 1e-9)


def test_terms_that_only_touch_leave_a_hole_of_one_point():
    assert uncovered(variable(left_shoulder(-1, 0), right_shoulder(0, 1))) == (0.0, 0.0)


def test_a_grade_that_fades_out_beside_an_upright_edge_is_no_cover():
    upright, fading = Trapezoid(-1, -1, 0, 0), triangle(0, 1, 1)
    assert uncovered(variable(upright, fading)) == (0.0, 0.0)
    assert uncovered(variable(upright, Trapezoid(0, 0, 1, 1))) is None


def test_a_universe_wider_than_its_terms_has_holes_at_its_ends():
    terms = (triangle(-1, -0.5, 0.5), triangle(-0.5, 0.5, 1))
    assert uncovered(variable(*terms, universe=(-1.5, 0.9))) == (-1.5, -1.0)
    assert uncovered(variable(*terms, universe=(-0.9, 1.5))) == (1.0, 1.5)
    assert uncovered(variable(*terms, universe=(-0.9, 0.9))) is None


def test_a_rule_base_with_a_hole_does_not_load():
    good = fsmc_rules()
    bad = Variable.shaped(
        "s",
        "m/s",
        (-1.0, 1.0),
        {
            "NB": left_shoulder(-1, -0.5),
            "NS": triangle(-1, -0.5, -0.1),
            "Z": triangle(-0.1, 0, 0.1),
            "PS": triangle(0.1, 0.5, 1),
            "PB": right_shoulder(0.5, 1),
        },
    )
    with pytest.raises(RuleBaseError, match=r"variable s: no term covers it at -0.1 m/s; let") as error:
        RuleBase(bad, good.rate, good.output, good.rules)
    assert error.value.exit_code == 2


CORNER = st.integers(-8, 8).map(lambda n: n / 8)


@st.composite
def variables(draw) -> Variable:
    ordered = sorted(
        draw(st.lists(st.lists(CORNER, min_size=4, max_size=4).map(sorted), min_size=2, max_size=4))
    )
    columns = [np.maximum.accumulate(column) for column in np.array(ordered).T]
    assume(all(a < d for a, d in zip(columns[0], columns[3], strict=True)))
    try:
        return variable(*(Trapezoid(*corners) for corners in zip(*columns, strict=True)))
    except RuleBaseError:
        assume(False)
        raise


@st.composite
def covered(draw) -> Variable:
    peaks = sorted(draw(st.sets(CORNER, min_size=2, max_size=4)))
    wider = draw(st.integers(0, 3)) / 8
    inner = [triangle(peaks[k - 1] - wider, peaks[k], peaks[k + 1] + wider) for k in range(1, len(peaks) - 1)]
    ends = left_shoulder(peaks[0], peaks[1] + wider), right_shoulder(peaks[-2] - wider, peaks[-1])
    terms = tuple(f"T{k}" for k in range(len(peaks)))
    return Variable("x", "1", terms, tuple(peaks), (ends[0], *inner, ends[1]))


def strength(error: Variable, rate: Variable, table: np.ndarray, errors, rates) -> np.ndarray:
    """The strongest rule at every pair of points."""
    of_error = np.array([[shape.grade(x) for shape in error.shapes] for x in errors])
    of_rate = np.array([[shape.grade(x) for shape in rate.shapes] for x in rates])
    each = np.minimum(of_rate[:, None, :, None], of_error[None, :, None, :])
    return np.where(table >= 0, each, 0.0).max(axis=(2, 3))


# Corners are eighths: these points hold all of them and both of their sides, and the middles between.
PROBES = np.unique([x for n in range(-8, 9) for x in (n / 8 - 1e-10, n / 8, n / 8 + 1e-10, n / 8 + 1 / 16)])
PROBES = PROBES[(PROBES >= -1) & (PROBES <= 1)]


@given(one=variables())
def test_a_variable_is_covered_exactly_if_no_probe_at_its_corners_finds_a_hole(one):
    best = np.array([max(one.grades(x)) for x in PROBES])
    assert (uncovered(one) is None) == (best.min() > 1e-8)


@given(data=st.data(), error=covered(), rate=covered())
def test_rules_cover_exactly_if_no_probe_at_the_corners_finds_a_hole(data, error, rate):
    cell = st.sampled_from((-1, 0, 0))
    row = st.lists(cell, min_size=len(error.terms), max_size=len(error.terms))
    table = data.draw(st.lists(row, min_size=len(rate.terms), max_size=len(rate.terms)))
    in_error = [x for x in PROBES if error.low <= x <= error.high]
    in_rate = [x for x in PROBES if rate.low <= x <= rate.high]
    least = strength(error, rate, np.array(table), in_error, in_rate).min()
    assert (no_rule_fires(error, rate, table) is None) == (least > 1e-8)


def test_pieces_end_at_corners_and_at_crossings():
    cuts = [piece.start for piece in pieces(variable(left_shoulder(-0.5, 0.5), right_shoulder(-0.5, 0.5)))]
    assert cuts == pytest.approx([-1.0, -0.5, 0.0, 0.5])
