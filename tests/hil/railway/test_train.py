from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil.railway import EffortCurve, RailwayDataError

speeds = st.floats(0.0, 60.0)
demands = st.floats(-1.0, 1.0)
same_fixture = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def test_effective_mass_has_the_allowance_for_rotating_parts(train):
    assert train.effective_mass_kg == pytest.approx(110_000.0)


def test_effort_curve_is_constant_then_a_power_hyperbola():
    curve = EffortCurve(180_000.0, 1_520_000.0)
    knee = 1_520_000.0 / 180_000.0
    assert curve.effort_n(0.0) == 180_000.0
    assert curve.effort_n(knee - 0.01) == 180_000.0
    assert curve.effort_n(15.0) == pytest.approx(1_520_000.0 / 15.0)
    assert curve.effort_n(-3.0) == 180_000.0


@given(speeds, speeds)
def test_effort_never_rises_with_speed_and_never_exceeds_its_limits(v1, v2):
    curve = EffortCurve(180_000.0, 1_520_000.0, ((0.0, 170_000.0), (10.0, 150_000.0), (30.0, 20_000.0)))
    low, high = sorted((v1, v2))
    assert curve.effort_n(high) <= curve.effort_n(low) + 1e-9
    assert curve.effort_n(high) * high <= 1_520_000.0 * (1 + 1e-12)
    assert curve.effort_n(low) <= 170_000.0


def test_effort_table_is_interpolated_linearly_and_held_beyond_its_ends():
    # w1 + (v - v1)(w2 - w1)/(v2 - v1); the printed form w1 + (v - v1) would give 150 005 N at 15 m/s
    curve = EffortCurve(1e9, None, ((5.0, 160_000.0), (10.0, 150_000.0), (20.0, 50_000.0)))
    assert curve.effort_n(15.0) == pytest.approx(100_000.0)
    assert curve.effort_n(7.5) == pytest.approx(155_000.0)
    assert curve.effort_n(0.0) == 160_000.0
    assert curve.effort_n(10.0) == 150_000.0
    assert curve.effort_n(99.0) == 50_000.0


def test_effort_table_must_ascend():
    with pytest.raises(RailwayDataError, match="speed 5 m/s follows 5 m/s; speeds must ascend"):
        EffortCurve(1.0, None, ((5.0, 1.0), (5.0, 2.0)))


def test_electrodynamic_brake_fades_out_linearly(train):
    brake = train.electrodynamic
    assert [brake.fade(v) for v in (0.0, 0.5, 1.25, 2.0, 20.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]
    assert brake.effort_n(1.25) == pytest.approx(50_000.0)
    assert brake.effort_n(30.0) == pytest.approx(50_000.0)  # 1500 kW at 30 m/s
    assert brake.effort_n(-1.0) == 0.0


def test_fade_start_must_lie_above_fade_end(train):
    with pytest.raises(RailwayDataError, match=r"fade start 0.5 m/s must be greater than fade end 0.5 m/s"):
        replace(train.electrodynamic, fade_start_mps=0.5)


def test_full_demands_are_full_traction_and_full_service_brake(train):
    assert train.effort_n(1.0, 0.0) == 110_000.0
    assert train.effort_n(1.0, 20.0) == pytest.approx(55_000.0)
    assert train.effort_n(-1.0, 20.0) == pytest.approx(-1.2 * 110_000.0)
    assert train.effort_n(-1.0, 0.0) == train.effort_n(-1.0, 20.0)
    assert train.effort_n(0.0, 10.0) == 0.0


@same_fixture
@given(demand=demands, speed=speeds)
def test_demand_and_effort_are_inverse(train, demand, speed):
    assert train.demand(train.effort_n(demand, speed), speed) == pytest.approx(demand, abs=1e-12)


@same_fixture
@given(first=demands, second=demands, speed=speeds)
def test_more_demand_never_gives_less_effort(train, first, second, speed):
    low, high = sorted((first, second))
    assert train.effort_n(low, speed) <= train.effort_n(high, speed)


@pytest.mark.parametrize(("demand", "limited"), [(3.0, 1.0), (-3.0, -1.0)])
def test_demands_and_efforts_beyond_the_limit_are_limited(train, demand, limited):
    assert train.effort_n(demand, 5.0) == train.effort_n(limited, 5.0)
    assert train.demand(2.0 * train.effort_n(limited, 5.0), 5.0) == limited


def test_demand_without_any_traction_left_is_zero(train):
    spent = replace(train.traction, curve=EffortCurve(1e5, None, ((0.0, 1e5), (20.0, 0.0))))
    assert replace(train, traction=spent).demand(1000.0, 25.0) == 0.0


def test_track_resistance_is_weight_times_permille(train):
    assert train.track_resistance_n(10.0) == pytest.approx(100_000.0 * 9.81 * 0.01)


def test_running_resistance_is_the_davis_parabola(train):
    assert train.running_resistance_n(10.0) == pytest.approx(1000.0 + 1000.0 + 400.0)


def test_adhesion_limit_counts_the_motored_weight_only(train):
    assert train.adhesion_limit_n(0.0) == pytest.approx(0.5 * 100_000.0 * 9.81 * (0.161 + 7.5 / 44.0))
