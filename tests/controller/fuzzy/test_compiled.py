from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numba import njit

from controller.fuzzy.bases import fsmc_rules, fuzzy_d_rules, fuzzy_pid_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.fuzzy.kernel import infer
from controller.fuzzy.membership import RuleBaseError, Trapezoid
from controller.fuzzy.oracle import reference
from controller.fuzzy.rulebase import (
    CentreAverage,
    ContinuousCentroid,
    DiscreteCentroid,
    RuleBase,
)
from controller.fuzzy.variable import Variable

# Membership functions fitted to the Fuzzy-D paper: set DU, control in the paper's unit.
PAPER = fuzzy_d_rules((6.866, 13.731), (1.443, 20.507), (391.20, 399.57, 541.99), output_unit="1")
EVEN = fuzzy_d_rules((0.5, 1.0), (0.5, 1.0), (1 / 3, 2 / 3, 1.0))
TRAIN = fuzzy_d_rules((0.5, 1.0), (1.0, 2.0), (0.5, 1.0, 1.5))

BASES = {
    "paper": PAPER,
    "even": EVEN,
    "train": TRAIN,
    "fsmc": fsmc_rules(),
    "textbook kp": fuzzy_pid_rules().kp,
    "symmetric kd": fuzzy_pid_rules(tables="symmetric").kd,
}

GOLDEN_PAPER = [
    (1.3731, 0, 30.242963),
    (3.43275, 0, 71.770389),
    (6.8655, 0, 444.090945),
    (13.731, 0, 498.064944),
    (0, 10.2535, 296.803358),
    (6.8655, -10.2535, 56.700911),
    (13.731, -20.507, 263.768467),
    (3.43275, -2.0507, -6.929431),
    (0.27462, 0, 6.631492),
    (-10.29825, 12.3042, -99.968625),
]
GOLDEN_EVEN = [
    (0.1, 0, 0.181636),
    (0.25, 0, 0.333200),
    (0.5, 0, 0.666531),
    (0.75, 0, 0.711240),
    (1, 0, 0.895385),
    (0, 0.5, 0.333469),
    (0.5, 0.5, 0.895385),
    (-0.25, 0.25, -0.166400),
    (0.25, -0.1, 0.241034),
]


@pytest.mark.parametrize(("error", "rate", "golden"), GOLDEN_PAPER)
def test_golden_values_of_the_paper_set(error, rate, golden):
    assert CompiledRuleBase(PAPER)(error, rate) == pytest.approx(golden, abs=1e-6)


@pytest.mark.parametrize(("error", "rate", "golden"), GOLDEN_EVEN)
def test_golden_values_of_the_even_set(error, rate, golden):
    assert CompiledRuleBase(EVEN)(error, rate) == pytest.approx(golden, abs=1e-6)


def spread(variable: Variable, count: int) -> np.ndarray:
    """Past the ends, on the corners and between them."""
    middle, half = 0.5 * (variable.low + variable.high), 0.5 * (variable.high - variable.low)
    corners = [x for term in variable.terms for x in variable.corners(term)]
    return np.unique([*np.linspace(middle - 1.3 * half, middle + 1.3 * half, count), *corners])


@pytest.fixture(params=[*BASES, "odd"])
def base(request, odd_rules) -> RuleBase:
    return BASES.get(request.param, odd_rules)


every_way = pytest.mark.parametrize(
    ("conjunction", "way"),
    [
        (conjunction, way)
        for conjunction in ("min", "product")
        for way in (DiscreteCentroid(101), ContinuousCentroid(), CentreAverage())
    ],
    ids=lambda x: x if isinstance(x, str) else type(x).__name__,
)


@every_way
def test_compiled_form_equals_the_reference_on_scikit_fuzzy_on_a_dense_grid(base, conjunction, way):
    rules = replace(base, conjunction=conjunction, defuzzification=way)
    compiled = CompiledRuleBase(rules)
    errors, rates = spread(rules.error, 12), spread(rules.rate, 9)
    expected = [[reference(rules, e, r) for r in rates] for e in errors]
    found = [[compiled(e, r) for r in rates] for e in errors]
    assert np.abs(np.subtract(found, expected)).max() <= 1e-9 * (rules.output.high - rules.output.low)


@st.composite
def variables(draw, name: str) -> Variable:
    """Any variable that loads: uneven peaks, plateaus, overlaps of more than two terms, upright edges."""
    steps = draw(st.lists(st.floats(0.05, 3.0), min_size=2, max_size=5))
    peaks = [float(x) for x in np.cumsum([draw(st.floats(-3, 3)), *steps])]
    share = draw(st.sampled_from((0.0, 0.1, 0.3)))
    wider = draw(st.sampled_from((0.0, 0.0, 0.4, 1.5)))
    shapes = {}
    for k, peak in enumerate(peaks):
        before, after = peaks[max(k - 1, 0)], peaks[min(k + 1, len(peaks) - 1)]
        top = peak - share * (peak - before), peak + share * (after - peak)
        shapes[f"T{k}"] = Trapezoid(before - wider, *top, after + wider)
    try:
        return Variable.shaped(name, "1", (peaks[0], peaks[-1]), shapes)
    except RuleBaseError:  # plateaus of unequal neighbours out of order
        assume(False)
        raise


@st.composite
def rule_bases(draw) -> RuleBase:
    error, rate, output = (draw(variables(name)) for name in ("error", "rate", "output"))
    row = st.lists(st.sampled_from(output.terms), min_size=len(error.terms), max_size=len(error.terms)).map(
        tuple
    )
    rows = draw(st.lists(row, min_size=len(rate.terms), max_size=len(rate.terms)).map(tuple))
    used = {cell for row in rows for cell in row}
    return RuleBase(
        error,
        rate,
        output,
        rows,
        draw(st.sampled_from(("min", "product"))),
        draw(st.sampled_from((DiscreteCentroid(101), ContinuousCentroid(), CentreAverage()))),
        tuple(f"output.{term}" for term in output.terms if term not in used),
    )


@settings(max_examples=400)
@given(rules=rule_bases(), data=st.data())
def test_compiled_form_equals_the_reference_on_random_rule_bases_at_random_points(rules, data):
    compiled = CompiledRuleBase(rules)
    for _ in range(5):
        error = data.draw(st.floats(rules.error.low - 1, rules.error.high + 1))
        rate = data.draw(st.floats(rules.rate.low - 1, rules.rate.high + 1))
        span = rules.output.high - rules.output.low
        assert abs(compiled(error, rate) - reference(rules, error, rate)) <= 1e-9 * span


@given(error=st.floats(-20, 20), rate=st.floats(-30, 30))
def test_surface_is_odd(error, rate):
    compiled = CompiledRuleBase(PAPER)
    assert compiled(-error, -rate) == pytest.approx(-compiled(error, rate), abs=1e-9)


def test_no_error_gives_no_control():
    assert CompiledRuleBase(PAPER)(0.0, 0.0) == pytest.approx(0.0, abs=1e-12)


@given(
    error=st.floats(allow_nan=False, allow_infinity=False),
    rate=st.floats(allow_nan=False, allow_infinity=False),
)
def test_inputs_outside_the_universe_are_clipped(error, rate):
    compiled = CompiledRuleBase(TRAIN)
    assert compiled(error, rate) == compiled(min(max(error, -1.0), 1.0), min(max(rate, -2.0), 2.0))
    assert abs(compiled(error, rate)) < 1.5


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_non_finite_input_is_an_error_and_never_a_command(bad):
    compiled = CompiledRuleBase(TRAIN)
    with pytest.raises(ValueError, match="not finite"):
        compiled(bad, 0.0)
    with pytest.raises(ValueError, match="not finite"):
        compiled(0.0, bad)


def test_the_result_does_not_depend_on_what_was_evaluated_before():
    fresh, used = CompiledRuleBase(TRAIN), CompiledRuleBase(TRAIN)
    for error in np.linspace(-1, 1, 11):
        used(error, -error)
    assert used(0.3, 0.1) == fresh(0.3, 0.1)


def test_inputs_outside_the_universe_are_counted_and_shown():
    compiled = CompiledRuleBase(TRAIN)
    compiled(1.0, -2.0)
    assert (compiled.clipped, compiled.is_clipping) == (0, False)
    compiled(1.01, 0.0)
    assert (compiled.clipped, compiled.is_clipping) == (1, True)
    compiled(-5.0, 2.5)
    assert (compiled.clipped, compiled.is_clipping) == (3, True)
    compiled(0.0, 0.0)
    assert (compiled.clipped, compiled.is_clipping) == (3, False)
    compiled.array([[0.0], [2.0]], [0.0, -3.0])
    assert (compiled.clipped, compiled.is_clipping) == (7, True)
    compiled.reset()
    assert (compiled.clipped, compiled.is_clipping) == (0, False)


def test_array_equals_single_evaluations_and_broadcasts():
    compiled = CompiledRuleBase(PAPER)
    errors, rates = np.linspace(-20, 20, 7)[:, None], np.linspace(-25, 25, 5)
    surface = compiled.array(errors, rates)
    assert surface.shape == (7, 5)
    assert surface.tolist() == [[compiled(e, r) for r in rates] for e in errors[:, 0]]
    assert compiled.array(1.0, 2.0) == compiled(1.0, 2.0)
    assert compiled.array([], []).shape == (0,)


def test_array_refuses_a_non_finite_input_and_names_it():
    with pytest.raises(ValueError, match=r"not finite: error 0.5, rate nan"):
        CompiledRuleBase(TRAIN).array([0.1, 0.5], [0.0, math.nan])


def test_activations_are_the_strengths_of_the_rules(odd_rules):
    compiled = CompiledRuleBase(TRAIN)
    shown = compiled.activations(0.4, 5.0)
    assert shown.shape == (5, 5)
    assert shown[4] == pytest.approx([0, 0, 0.2, 0.8, 0])
    assert not shown[:4].any()
    assert compiled.clipped == 0
    product = CompiledRuleBase(fuzzy_pid_rules().kp)
    assert product.activations(0.25, -1.25).sum() == pytest.approx(1.0)
    assert product.activations(0.25, -1.25)[1, 3] == pytest.approx(0.25 * 0.75)
    assert CompiledRuleBase(odd_rules).activations(0.0, -1.0)[0, 1] == 0.0
    with pytest.raises(ValueError, match="not finite"):
        compiled.activations(math.nan, 0.0)


@njit
def largest(steps, arguments):
    found = -math.inf
    for n in range(steps):
        found = max(found, infer(-1.0 + 2.0 * n / (steps - 1), 0.0, *arguments))
    return found, infer(math.nan, 0.0, *arguments), infer(0.0, math.inf, *arguments)


def test_a_compiled_loop_of_a_study_can_call_the_kernel():
    compiled = CompiledRuleBase(EVEN)
    found, without_error, without_rate = largest(201, compiled.arguments)
    assert found == compiled.array(np.linspace(-1, 1, 201), 0.0).max()
    assert math.isnan(without_error)
    assert math.isnan(without_rate)


def test_whole_numbers_are_evaluated_like_any_other():
    assert CompiledRuleBase(TRAIN)(1, 0) == CompiledRuleBase(TRAIN)(1.0, 0.0)


@pytest.mark.parametrize("value", [1e-4, 0.3, 0.999])
def test_continuous_centroid_of_one_cut_triangle_is_the_formula(value):
    # Two right triangles over -1..1; an error of `value` cuts N at (1-value)/2 and P at (1+value)/2.
    error = Variable("error", "1", ("N", "P"), (-1.0, 1.0))
    output = Variable("output", "1", ("N", "P"), (-1.0, 1.0))
    rules = RuleBase(error, error, output, (("N", "P"), ("N", "P")), "min", ContinuousCentroid())
    low, high = (1 - value) / 2, (1 + value) / 2
    # The aggregate: level `low` up to the flank of P, along the flank up to level `high`, level.
    a, b = -1 + 2 * low, -1 + 2 * high
    area = low * (a + 1) + (low + high) / 2 * (b - a) + high * (1 - b)
    # Moments of the three parts about 0, by integrating z(1+z)/2 along the flank.
    moment = low * (a * a - 1) / 2 + ((b * b - a * a) / 4 + (b**3 - a**3) / 6) + high * (1 - b * b) / 2
    assert CompiledRuleBase(rules)(value, 1.0) == pytest.approx(moment / area, rel=1e-12)
