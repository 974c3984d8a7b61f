from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.config import ProfileConfig
from controller.profile import ProfileError
from controller.profile.plain import fastest_time_s, plain_profile
from hil.railway import Gradient, Line, SpeedLimit, Stop

SCENARIOS = ["cat_linh_la_thanh", "fuzzy_d_2km", "la_thanh_cat_linh", "metro_1500m"]
CONFIG = ProfileConfig()


def line(*, limits=(), gradients=(), end=1000.0) -> Line:
    return Line(
        name="test",
        start_m=-200.0,
        end_m=end + 200.0,
        default_limit_mps=20.0,
        stops=(Stop("A", 0.0), Stop("B", end)),
        speed_limits=tuple(SpeedLimit(*limit) for limit in limits),
        gradients=tuple(Gradient(*gradient) for gradient in gradients),
    )


@pytest.fixture
def on(journeys):
    """A journey from A to B on a given line with the Cat Linh train."""

    def make(track: Line):
        return replace(
            journeys["cat_linh_la_thanh"], line=track, origin=track.stops[0], destination=track.stops[1]
        )

    return make


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("share", [1.0, 1.02, 1.1, 1.3, 1.8])
def test_plan_stays_under_every_limit_with_the_whole_train(journeys, name, share):
    journey = journeys[name]
    profile = plain_profile(journey, CONFIG, time_s=share * fastest_time_s(journey, CONFIG))
    limits = [journey.line.speed_limit_mps(x, journey.train.length_m) for x in profile.position_m]
    assert np.min(np.array(limits) - profile.speed_mps) >= CONFIG.speed_margin_mps - 0.01


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("share", [1.0, 1.02, 1.1, 1.3, 1.8])
def test_plan_arrives_on_time_at_the_stop(journeys, name, share):
    journey = journeys[name]
    wanted = share * fastest_time_s(journey, CONFIG)
    profile = plain_profile(journey, CONFIG, time_s=wanted)
    assert profile.duration_s == pytest.approx(wanted, abs=0.02)
    assert profile.start_m == journey.origin.position_m
    assert profile.end_m == journey.destination.position_m
    assert profile.speed_mps[0] == profile.speed_mps[-1] == 0.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_plan_keeps_the_jerk_and_the_accelerations(journeys, name):
    journey = journeys[name]
    train = journey.train
    for share in (1.0, 1.05, 1.3):
        profile = plain_profile(journey, CONFIG, time_s=share * fastest_time_s(journey, CONFIG))
        jerk = np.diff(profile.acceleration_mps2) / np.diff(profile.time_s)
        # 10 %: where a coasting phase is shorter than the window two ramps may overlap a little.
        assert np.max(np.abs(jerk)) <= 1.1 * train.comfort_jerk_mps3
        assert np.max(profile.acceleration_mps2) <= 0.85 * train.max_acceleration_mps2 + 1e-6
        assert np.min(profile.acceleration_mps2) >= -0.62 * train.max_braking_mps2 - 1e-6


@pytest.mark.parametrize("name", SCENARIOS)
def test_plan_needs_no_more_effort_than_its_share(journeys, name):
    journey = journeys[name]
    train, track = journey.train, journey.line
    profile = plain_profile(journey, CONFIG, time_s=fastest_time_s(journey, CONFIG))
    for k in range(0, len(profile.time_s), 25):
        x, v = profile.position_m[k], float(profile.speed_mps[k])
        specific = track.mean_specific_resistance(x, train.length_m)
        resistance = train.running_resistance_n(v) + train.track_resistance_n(specific)
        effort = train.effective_mass_kg * profile.acceleration_mps2[k] + resistance
        # Smoothing shifts the run by a metre or so against gradients and the power hyperbola.
        assert effort <= (CONFIG.traction_share + 0.03) * train.traction_effort_n(v)
        assert effort >= -(CONFIG.brake_share + 0.03) * train.service_brake_effort_n(v)


def test_acceleration_waits_until_the_rear_has_left_the_limit(on):
    journey = on(line(limits=[(300.0, 400.0, 8.0)]))
    profile = plain_profile(journey, CONFIG, time_s=fastest_time_s(journey, CONFIG))
    slow = (profile.position_m >= 300.0) & (profile.position_m <= 400.0 + journey.train.length_m)
    assert np.max(profile.speed_mps[slow]) <= 8.0
    assert np.max(profile.speed_mps[profile.position_m > 500.0]) > 12.0


def test_between_accelerating_and_braking_there_is_a_pause(on):
    # A hop so short that the fastest run would go straight from traction to brake.
    journey = on(line(end=150.0))
    profile = plain_profile(journey, CONFIG, time_s=fastest_time_s(journey, CONFIG))
    jerk = np.diff(profile.acceleration_mps2) / np.diff(profile.time_s)
    # Without the pause it would be twice the comfortable jerk; the pause is whole steps of the mesh.
    assert np.max(np.abs(jerk)) <= 1.03 * journey.train.comfort_jerk_mps3


def test_more_time_never_means_more_speed(journeys):
    journey = journeys["fuzzy_d_2km"]
    fastest = fastest_time_s(journey, CONFIG)
    tops = [
        float(np.max(plain_profile(journey, CONFIG, time_s=share * fastest).speed_mps))
        for share in (1.0, 1.01, 1.05, 1.2, 1.5)
    ]
    assert tops == sorted(tops, reverse=True)
    assert tops[-1] < tops[0] - 1.0


def test_with_time_to_spare_the_train_coasts(journeys):
    journey = journeys["fuzzy_d_2km"]
    profile = plain_profile(journey, CONFIG, time_s=1.05 * fastest_time_s(journey, CONFIG))
    train, track = journey.train, journey.line
    specific = np.array([track.mean_specific_resistance(x, train.length_m) for x in profile.position_m])
    resistance = np.array([train.running_resistance_n(v) for v in profile.speed_mps])
    drag = (resistance + specific * train.mass_kg * 9.81e-3) / train.effective_mass_kg
    coasting = (np.abs(profile.acceleration_mps2 + drag) < 0.005) & (drag > 0.02) & (profile.speed_mps > 5)
    assert np.sum(np.diff(profile.time_s)[coasting[:-1]]) > 5.0


def test_a_climb_slows_the_plan_where_traction_is_too_weak(on):
    climb = on(line(gradients=[(50.0, 600.0, 60.0)]))
    level = on(line())
    assert fastest_time_s(climb, CONFIG) > fastest_time_s(level, CONFIG) + 1.0


def test_a_climb_too_steep_is_an_error_that_says_where(on):
    with pytest.raises(ProfileError, match=r"cannot climb at \d+ m"):
        fastest_time_s(on(line(gradients=[(100.0, 900.0, 95.0)], end=1500.0)), replace_share(0.5))


def test_a_descent_too_steep_to_brake_is_an_error_that_says_where(on):
    with pytest.raises(ProfileError, match=r"cannot brake at \d+ m"):
        fastest_time_s(
            on(line(gradients=[(500.0, 1000.0, -95.0)])), CONFIG.model_copy(update={"brake_share": 0.6})
        )


def replace_share(share: float) -> ProfileConfig:
    return CONFIG.model_copy(update={"traction_share": share})


def test_a_timetable_too_short_names_the_shortest(journeys):
    journey = journeys["cat_linh_la_thanh"]
    fastest = fastest_time_s(journey, CONFIG)
    with pytest.raises(ProfileError, match="must be at least") as error:
        plain_profile(journey, CONFIG, time_s=fastest - 1.0)
    named = float(str(error.value).split("at least ")[1].split(",")[0])
    assert fastest <= named <= fastest + 0.11
    assert plain_profile(journey, CONFIG, time_s=named).duration_s == pytest.approx(named, abs=0.02)


def test_a_timetable_too_long_names_the_longest(journeys):
    with pytest.raises(ProfileError, match="must be at most"):
        plain_profile(journeys["cat_linh_la_thanh"], CONFIG, time_s=1e5)


def test_the_time_to_release_the_brake_is_part_of_the_timetable(journeys):
    journey = journeys["cat_linh_la_thanh"]
    profile = plain_profile(journey, CONFIG, time_s=95.0, dwell_s=1.5)
    assert profile.duration_s == pytest.approx(93.5, abs=0.02)
