import doctest

import pytest

from hil.railway import resistance


def test_worked_examples_of_the_docstrings_hold():
    result = doctest.testmod(resistance)
    assert result.attempted >= 10
    assert result.failed == 0


def test_specific_resistance_and_force_are_inverse():
    assert resistance.n_to_specific(resistance.specific_to_n(7.3, 142_360.0), 142_360.0) == pytest.approx(7.3)


def test_running_resistance_acts_against_the_motion_in_both_directions():
    assert resistance.davis_n(-15.0, 2965.0, 230.0, 5.0) == resistance.davis_n(15.0, 2965.0, 230.0, 5.0)


def test_davis_coefficients_in_kmh_and_in_si_give_the_same_force():
    a, b, c = resistance.davis_from_kmh(1.75, 0.0234, 0.000184, 142_360.0)
    specific = 1.75 + 0.0234 * 54.0 + 0.000184 * 54.0**2
    assert resistance.davis_n(15.0, a, b, c) == pytest.approx(specific * 142.36 * 9.81)


def test_roeckl_falls_with_the_radius_within_each_branch_and_jumps_at_300_m():
    roeckl = resistance.curve_roeckl_n_per_kn
    assert roeckl(150.0) > roeckl(200.0) > roeckl(299.0)
    assert roeckl(300.0) > roeckl(500.0) > roeckl(1000.0)
    assert roeckl(300.0) == pytest.approx(650 / 245)  # the branch for 300 m and more, not 500/270


@pytest.mark.parametrize("radius_m", [30.0, 0.0, -100.0, float("nan")])
def test_roeckl_refuses_a_radius_without_meaning(radius_m):
    with pytest.raises(ValueError, match="more than 30 m"):
        resistance.curve_roeckl_n_per_kn(radius_m)


def test_adhesion_falls_with_speed():
    values = [resistance.curtius_kniffler(v) for v in (0.0, 5.0, 15.0, 30.0, 80.0)]
    assert values == sorted(values, reverse=True)
    assert all(0.161 < value < 0.332 for value in values)
