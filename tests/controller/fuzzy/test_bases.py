from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from controller.fuzzy.bases import NINE_TERMS, fsmc_rules, fuzzy_d_rules, fuzzy_pid_rules, mirrored
from controller.fuzzy.compiled import CompiledRuleBase
from controller.fuzzy.rulebase import SEVEN_TERMS, CentreAverage, DiscreteCentroid

FSMC = CompiledRuleBase(fsmc_rules())
HALF_RANGE = 0.75
EVERYWHERE = st.floats(-1.5, 1.5)


def fsmc_by_closed_form(s: float, rate: float) -> float:
    """Worked out from the 25 rules: on each of the 16 squares four rules fire, outputs (i + j) / 4."""
    x = min(max(2 * s / HALF_RANGE, -2), 2)
    y = min(max(2 * rate / HALF_RANGE, -2), 2)
    i, j = min(math.floor(x), 1), min(math.floor(y), 1)
    a, b = x - i, y - j
    w00, w10, w01, w11 = min(1 - a, 1 - b), min(a, 1 - b), min(1 - a, b), min(a, b)
    total = w00 + w10 + w01 + w11
    return (w00 * (i + j) + (w10 + w01) * (i + j + 1) + w11 * (i + j + 2)) / (4 * total)


def test_speedt_and_fuzzy_d_defuzzify_over_101_points_as_matlab_does():
    assert fuzzy_d_rules((0.5, 1), (0.5, 1), (1, 2, 3)).defuzzification == DiscreteCentroid(101)


def test_every_cell_of_the_sliding_mode_table_is_the_sum_of_its_heads():
    rules = fsmc_rules()
    for i, row in enumerate(rules.consequents):
        assert [term - 4 for term in row] == [i - 2 + j - 2 for j in range(5)]
    assert rules.output.terms == NINE_TERMS
    assert rules.output.peaks == (-1, -0.75, -0.5, -0.25, 0, 0.25, 0.5, 0.75, 1)
    assert (rules.conjunction, rules.defuzzification) == ("min", CentreAverage())


def test_sliding_mode_equals_its_closed_form_on_a_dense_grid():
    values = np.unique([*np.linspace(-1, 1, 161), *fsmc_rules().error.peaks])
    found = FSMC.array(values[:, None], values)
    expected = [[fsmc_by_closed_form(s, rate) for rate in values] for s in values]
    assert np.abs(found - expected).max() <= 1e-12


@given(s=EVERYWHERE, rate=EVERYWHERE)
def test_sliding_mode_equals_its_closed_form_at_random_points(s, rate):
    assert abs(FSMC(s, rate) - fsmc_by_closed_form(s, rate)) <= 1e-12


@given(s=EVERYWHERE, rate=EVERYWHERE, more=st.floats(0, 1))
def test_sliding_mode_is_odd_and_monotone_in_both_inputs(s, rate, more):
    assert FSMC(-s, -rate) == pytest.approx(-FSMC(s, rate), abs=1e-12)
    assert FSMC(s + more, rate) >= FSMC(s, rate) - 1e-12
    assert FSMC(s, rate + more) >= FSMC(s, rate) - 1e-12


@given(s=st.floats(-0.75, 0.75))
def test_sliding_mode_alone_in_s_has_half_the_authority(s):
    assert FSMC(s, 0.0) == pytest.approx(s / 1.5, abs=1e-12)


def test_sliding_mode_reaches_one_and_stays_near_its_plane():
    assert FSMC(0.75, 0.75) == 1.0
    assert FSMC(-0.75, -0.75) == -1.0
    values = np.linspace(-0.75, 0.75, 1201)
    away = FSMC.array(values[:, None], values) - (values[:, None] + values) / 1.5
    assert np.abs(away).max() == pytest.approx(0.0429, abs=1e-4)


def test_sliding_mode_scales_with_its_half_ranges():
    scaled = CompiledRuleBase(fsmc_rules(0.161, 9.0))
    assert scaled(0.05, -2.0) == pytest.approx(FSMC(0.05 / 0.161 * 0.75, -2.0 / 9.0 * 0.75), abs=1e-12)


# Numbers -3 (NB) to 3 (PB); rows: error NB..PB; columns: its rate NB..PB.
TEXTBOOK = {
    "kp": """ 3  3  2  2  1  0  0 |  3  3  2  1  1  0 -1 |  2  2  2  1  0 -1 -1 |  2  2  1  0 -1 -2 -2
            | 1  1  0 -1 -1 -2 -2 |  1  0 -1 -2 -2 -2 -3 |  0  0 -2 -2 -2 -3 -3""",
    "ki": """-3 -3 -2 -2 -1  0  0 | -3 -3 -2 -1 -1  0  0 | -3 -2 -1 -1  0  1  1 | -2 -2 -1  0  1  2  2
            |-2 -1  0  1  1  2  3 |  0  0  1  1  2  3  3 |  0  0  1  2  2  3  3""",
    "kd": """ 1 -1 -3 -3 -3 -2  1 |  1 -1 -3 -2 -2 -1  0 |  0 -1 -2 -2 -1 -1  0 |  0 -1 -1 -1 -1 -1  0
            | 0  0  0  0  0  0  0 |  3 -1  1  1  1  1  3 |  3  2  2  2  1  1  3""",
}


@pytest.mark.parametrize("gain", TEXTBOOK)
def test_textbook_surface_is_the_bilinear_interpolation_of_its_table(gain):
    table = np.array([[float(x) for x in row.split()] for row in TEXTBOOK[gain].split("|")])
    bilinear = RegularGridInterpolator((np.arange(-3, 4), np.arange(-3, 4)), table)
    compiled = CompiledRuleBase(getattr(fuzzy_pid_rules(6.0, 1.5), gain))
    errors, rates = np.meshgrid(np.linspace(-6, 6, 41), np.linspace(-1.5, 1.5, 37))
    expected = bilinear(np.stack([errors / 2, rates / 0.5], axis=-1))
    assert np.abs(compiled.array(errors, rates) - expected).max() <= 1e-12


def test_textbook_tables_are_not_mirror_symmetric():
    kp = CompiledRuleBase(fuzzy_pid_rules().kp)
    assert (kp(-3.0, 0.0), kp(3.0, 0.0)) == (2.0, -2.0)


SYMMETRIC = [CompiledRuleBase(rules) for rules in fuzzy_pid_rules(tables="symmetric")]


@given(error=st.floats(0, 4), rate=st.floats(0, 4))
def test_symmetric_tables_depend_on_sizes_only(error, rate):
    for gain in SYMMETRIC:
        all_signs = [gain(e, r) for e in (error, -error) for r in (rate, -rate)]
        assert all_signs == pytest.approx([gain(error, rate)] * 4, abs=1e-12)


def test_symmetric_tables_say_what_the_prose_of_the_paper_says():
    kp, ki, kd = SYMMETRIC
    small, medium, large = 0.0, 2.0, 3.0
    for rate in np.linspace(0, 3, 13):
        # |error| large: large kp, small kd, no ki.
        assert (kp(large, rate), ki(large, rate), kd(large, rate)) == (3.0, -3.0, -3.0)
        # Medium: smaller kp, the others moderate.
        assert kp(medium, rate) < 0
        assert abs(ki(medium, rate)) <= 1.0
        assert kd(medium, rate) == 0.0
        # Small: greater kp and ki.
        assert kp(small, rate) > 0
        assert ki(small, rate) > 0
    # Small: kd large where the rate is small, small where it is large.
    assert kd(small, 0.0) == 3.0
    assert np.all(np.diff([kd(small, rate) for rate in np.linspace(0, 3, 13)]) < 0)
    assert kd(small, 3.0) < 0


def test_mirrored_table_has_the_quarter_in_its_middle_and_corners():
    assert mirrored((("a", "b"), ("c", "d"))) == (("d", "c", "d"), ("b", "a", "b"), ("d", "c", "d"))


def test_fuzzy_pid_uses_product_and_centre_average_over_integers():
    for rules in (*fuzzy_pid_rules(), *fuzzy_pid_rules(tables="symmetric")):
        assert (rules.conjunction, rules.defuzzification) == ("product", CentreAverage())
        assert rules.output.peaks == (-3, -2, -1, 0, 1, 2, 3)
        assert rules.error.terms == rules.rate.terms == SEVEN_TERMS
