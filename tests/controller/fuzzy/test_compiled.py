from __future__ import annotations

import math

import numpy as np
import pytest
import skfuzzy
from hypothesis import given
from hypothesis import strategies as st

from controller.fuzzy.compiled import CompiledRuleBase
from controller.fuzzy.rulebase import RuleBase, fuzzy_d_rules

# Membership functions fitted to the Fuzzy-D paper: set DU, control in the paper's unit.
PAPER = fuzzy_d_rules((6.866, 13.731), (1.443, 20.507), (391.20, 399.57, 541.99), output_unit="1")
EVEN = fuzzy_d_rules((0.5, 1.0), (0.5, 1.0), (1 / 3, 2 / 3, 1.0))
TRAIN = fuzzy_d_rules((0.5, 1.0), (1.0, 2.0), (0.5, 1.0, 1.5))

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


def by_scikit_fuzzy(rules: RuleBase, error: float, rate: float) -> float:
    """The readable definition: trimf memberships of scikit-fuzzy, discrete centroid in plain numpy."""
    z = np.array(rules.universe())

    def grades(variable, value):
        value = min(max(value, variable.peaks[0]), variable.peaks[-1])
        return [skfuzzy.trimf(np.array([value]), variable.triangle(t))[0] for t in variable.terms]

    error_grades, rate_grades = grades(rules.error, error), grades(rules.rate, rate)
    aggregate = np.zeros_like(z)
    for i, row in enumerate(rules.rules):
        for j, term in enumerate(row):
            height = min(rate_grades[i], error_grades[j])
            shape = skfuzzy.trimf(np.clip(z, z[0], rules.output.peaks[-1]), rules.output.triangle(term))
            aggregate = np.maximum(aggregate, np.minimum(height, shape))
    return float(np.sum(z * aggregate) / np.sum(aggregate))


@pytest.mark.parametrize(("error", "rate", "golden"), GOLDEN_PAPER)
def test_golden_values_of_the_paper_set(error, rate, golden):
    assert CompiledRuleBase(PAPER)(error, rate) == pytest.approx(golden, abs=1e-6)


@pytest.mark.parametrize(("error", "rate", "golden"), GOLDEN_EVEN)
def test_golden_values_of_the_even_set(error, rate, golden):
    assert CompiledRuleBase(EVEN)(error, rate) == pytest.approx(golden, abs=1e-6)


@pytest.mark.parametrize("rules", [PAPER, EVEN, TRAIN], ids=["paper", "even", "train"])
def test_compiled_form_equals_scikit_fuzzy_on_a_dense_grid(rules):
    compiled = CompiledRuleBase(rules)
    scale = rules.output.peaks[-1]
    # Past the ends, on the peaks and between them.
    errors = np.unique(
        [*np.linspace(1.3 * rules.error.peaks[0], 1.3 * rules.error.peaks[-1], 27), *rules.error.peaks]
    )
    rates = np.unique(
        [*np.linspace(1.3 * rules.rate.peaks[0], 1.3 * rules.rate.peaks[-1], 23), *rules.rate.peaks]
    )
    worst = max(abs(compiled(e, r) - by_scikit_fuzzy(rules, e, r)) for e in errors for r in rates)
    assert worst <= 1e-9 * scale


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
