from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.profile import ProfileError, SpeedProfile


def trapezoid(top=10.0, acceleration=1.0, cruise_m=200.0) -> SpeedProfile:
    ramp = top * top / (2.0 * acceleration)
    position = np.concatenate(
        (
            np.linspace(0, ramp, 51),
            ramp + np.array([cruise_m]),
            ramp + cruise_m + np.linspace(0, ramp, 51)[1:],
        )
    )
    speed = np.concatenate(
        (
            np.sqrt(2 * acceleration * np.linspace(0, ramp, 51)),
            [top],
            np.sqrt(2 * acceleration * np.linspace(ramp, 0, 51)[1:]),
        )
    )
    return SpeedProfile.from_speeds(position, speed)


def test_time_of_constant_acceleration_is_exact():
    profile = trapezoid(top=10.0, acceleration=1.0, cruise_m=200.0)
    assert profile.duration_s == pytest.approx(10.0 + 20.0 + 10.0, abs=1e-9)
    assert profile.acceleration_mps2[5] == pytest.approx(1.0)
    assert profile.acceleration_mps2[-3] == pytest.approx(-1.0)


@given(window=st.floats(0.2, 5.0), top=st.floats(2.0, 30.0), acceleration=st.floats(0.2, 1.5))
def test_smoothing_keeps_the_distance_bounds_the_jerk_and_costs_its_window(window, top, acceleration):
    sharp = trapezoid(top, acceleration)
    smooth = sharp.smoothed(window)
    assert smooth.start_m == sharp.start_m
    assert smooth.end_m == sharp.end_m
    assert smooth.duration_s == pytest.approx(sharp.duration_s + window, abs=1e-9)
    assert np.max(smooth.speed_mps) <= np.max(sharp.speed_mps) + 1e-6
    jerk = np.diff(smooth.acceleration_mps2) / np.diff(smooth.time_s)
    steps = 2 if top / acceleration < window else 1  # ramps up and down may fall into one window
    assert np.max(np.abs(jerk)) <= steps * acceleration / window * 1.01 + 1e-6


def test_smoothed_speed_is_the_derivative_of_position_and_integral_of_acceleration():
    smooth = trapezoid().smoothed(1.2)
    dt = np.diff(smooth.time_s)
    mean_speed = 0.5 * (smooth.speed_mps[1:] + smooth.speed_mps[:-1])
    np.testing.assert_allclose(np.diff(smooth.position_m) / dt, mean_speed, atol=1e-4)
    mean_acceleration = 0.5 * (smooth.acceleration_mps2[1:] + smooth.acceleration_mps2[:-1])
    np.testing.assert_allclose(np.diff(smooth.speed_mps) / dt, mean_acceleration, atol=2e-2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"speed_mps": np.array([0.0, np.nan, 0.0])}, "must be finite"),
        ({"time_s": np.array([0.0, 2.0, 2.0])}, "time_s must start at 0 and ascend"),
        ({"position_m": np.array([0.0, 2.0, 1.0])}, "position_m must not descend"),
        ({"speed_mps": np.array([0.0, -1.0, 0.0])}, "speed_mps must not be negative"),
        ({"time_s": np.array([0.0, 1.0])}, "lengths"),
    ],
)
def test_contradicting_arrays_are_rejected(change, message):
    arrays = {
        "position_m": np.array([0.0, 1.0, 2.0]),
        "speed_mps": np.array([0.0, 1.0, 0.0]),
        "acceleration_mps2": np.zeros(3),
        "time_s": np.array([0.0, 2.0, 4.0]),
    }
    with pytest.raises(ProfileError, match=message):
        SpeedProfile(**(arrays | change))


def test_a_profile_that_never_leaves_is_rejected():
    with pytest.raises(ProfileError, match="stands at 0 m"):
        SpeedProfile.from_speeds(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 1.0]))


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        trapezoid().speed_mps[0] = 1.0
