"""The optimal plan: comfortable, within limits, on time, and never dearer than the plain one."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from controller.config import ProfileConfig
from controller.effort import EffortMap
from controller.profile import ProfileError
from controller.profile.comfort import Comfort
from controller.profile.optimal import OptimalPlanner, SharpStart, optimal_profile
from controller.profile.plain import plain_profile
from controller.profile.plateau import with_plateaus
from hil.railway import SpeedLimit

SCENARIOS = ["cat_linh_la_thanh", "fuzzy_d_2km", "la_thanh_cat_linh", "metro_1500m"]
CONFIG = ProfileConfig()
SHARES = [1.0, 1.01, 1.05, 1.3, 2.0]


def fastest_s(journey) -> float:
    planner = OptimalPlanner(journey, CONFIG)
    return planner.fastest_s + planner.comfort.delay_s


def jerk_mps3(profile):
    return np.diff(profile.acceleration_mps2) / np.diff(profile.time_s)


def traction_j(journey, profile) -> float:
    """Traction work at the rim, from the profile alone."""
    effort = EffortMap(journey.line, journey.train)
    speed = profile.speed_mps
    resistance = [
        effort.resistance_mps2(float(x), float(v)) for x, v in zip(profile.position_m, speed, strict=True)
    ]
    force = journey.train.effective_mass_kg * (profile.acceleration_mps2 + np.array(resistance))
    return float(np.sum(np.maximum(force, 0.0) * speed * np.gradient(profile.time_s)))


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("share", SHARES)
def test_it_keeps_limits_jerk_and_time(journeys, name, share):
    journey = journeys[name]
    wanted = share * fastest_s(journey)
    profile = optimal_profile(journey, CONFIG, time_s=wanted)
    assert profile.duration_s == pytest.approx(wanted, abs=0.002)
    assert (profile.start_m, profile.end_m) == (journey.origin.position_m, journey.destination.position_m)
    assert profile.speed_mps[0] == profile.speed_mps[-1] == 0.0
    limits = [journey.line.speed_limit_mps(x, journey.train.length_m) for x in profile.position_m]
    assert np.min(np.array(limits) - profile.speed_mps) >= CONFIG.speed_margin_mps - 0.01
    # 5 %: a step up to 4 % above the allowed one gets less than a whole plateau
    assert np.max(np.abs(jerk_mps3(profile))) <= 1.05 * journey.train.comfort_jerk_mps3
    comfort = Comfort.of(journey.train, CONFIG)
    assert np.max(profile.acceleration_mps2) <= comfort.acceleration_mps2 + 1e-6
    assert np.min(profile.acceleration_mps2) >= -comfort.braking_mps2 - 1e-6


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("share", [1.01, 1.05, 1.2])
def test_it_never_costs_more_than_the_plain_plan(journeys, name, share):
    journey = journeys[name]
    wanted = share * fastest_s(journey)
    optimal = traction_j(journey, optimal_profile(journey, CONFIG, time_s=wanted))
    plain = traction_j(journey, plain_profile(journey, CONFIG, time_s=wanted))
    # 0.1 %: on level track without limits the plain plan is the optimal one, and both are sampled
    assert optimal <= 1.001 * plain


def test_it_saves_a_tenth_where_limits_and_gradients_leave_a_choice(journeys):
    journey = journeys["cat_linh_la_thanh"]
    optimal = optimal_profile(journey, CONFIG, time_s=86.8)
    plain = plain_profile(journey, CONFIG, time_s=86.8)
    assert traction_j(journey, optimal) < 0.9 * traction_j(journey, plain)


@pytest.mark.parametrize("name", SCENARIOS)
def test_more_time_never_costs_more(journeys, name):
    journey = journeys[name]
    fastest = fastest_s(journey)
    energy = [
        traction_j(journey, optimal_profile(journey, CONFIG, time_s=share * fastest)) for share in SHARES
    ]
    assert all(later <= 1.0005 * sooner for sooner, later in pairwise(energy))


def test_both_planners_are_equally_fast(journeys):
    for name in SCENARIOS:
        fastest = fastest_s(journeys[name])
        assert plain_profile(journeys[name], CONFIG, time_s=fastest + 0.1).duration_s == pytest.approx(
            fastest + 0.1, abs=0.01
        )
        with pytest.raises(ProfileError):
            plain_profile(journeys[name], CONFIG, time_s=fastest - 0.1)


def test_a_time_too_short_or_too_long_names_the_limit(journeys):
    journey = journeys["cat_linh_la_thanh"]
    fastest = fastest_s(journey)
    with pytest.raises(ProfileError, match="must be at least") as error:
        optimal_profile(journey, CONFIG, time_s=fastest - 1.0)
    named = float(str(error.value).split("at least ")[1].split(",")[0])
    assert fastest <= named <= fastest + 0.11
    with pytest.raises(ProfileError, match="must be at most"):
        optimal_profile(journey, CONFIG, time_s=10.0 * fastest)


def test_a_restriction_holds_for_the_whole_train(journeys):
    journey = journeys["cat_linh_la_thanh"]
    planner = OptimalPlanner(journey, CONFIG, restrictions=[SpeedLimit(600.0, 650.0, 8.0)])
    profile = planner.comfort.smoothed(planner.fastest())
    inside = (profile.position_m >= 600.0) & (profile.position_m <= 650.0 + journey.train.length_m)
    assert np.max(profile.speed_mps[inside]) <= 8.0
    assert planner.fastest_s > OptimalPlanner(journey, CONFIG).fastest_s + 5.0


def test_a_train_too_fast_for_a_limit_is_let_down_to_it_by_braking(journeys):
    journey = journeys["cat_linh_la_thanh"]
    restriction = SpeedLimit(500.0, 700.0, 6.0)
    planner = OptimalPlanner(journey, CONFIG, start=SharpStart(480.0, 12.0), restrictions=[restriction])
    plan = planner.fastest()
    braking = plan.acceleration_mps2[:-1][plan.speed_mps[:-1] > 6.5][:50]
    assert np.all(braking[1:20] < -0.9 * planner.comfort.braking_mps2 * 0.9)
    assert np.min(plan.speed_mps[plan.position_m < 700.0]) <= 6.0


def test_a_plateau_lasts_a_window_and_only_steep_peaks_get_one():
    x = np.array([0.0, 100.0, 200.0])
    steep = np.sqrt(2.0 * np.array([0.0, 80.0, 0.0]))  # 0.8 m/s2 up and down
    mesh, speed = with_plateaus(x, steep, 1.5, 1.0)
    assert len(mesh) == 4
    assert speed[1] == pytest.approx(speed[2])
    assert (mesh[2] - mesh[1]) / speed[1] == pytest.approx(1.5, abs=1e-6)
    mesh, speed = with_plateaus(x, steep, 1.5, 1.7)
    np.testing.assert_array_equal(mesh, x)


def test_a_plateau_does_not_reach_beyond_a_valley():
    x = np.array([0.0, 100.0, 200.0, 300.0, 310.0, 320.0, 420.0])
    y = np.array([0.0, 90.0, 90.0, 30.0, 31.0, 30.0, 0.0])
    mesh, speed = with_plateaus(x, np.sqrt(2.0 * y), 3.0, 0.2)
    assert np.max(speed) == pytest.approx(np.sqrt(180.0))
    assert np.interp(150.0, mesh, speed) == pytest.approx(np.sqrt(180.0))
