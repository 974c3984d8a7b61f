import numpy as np
import pytest

from hil.bench.metrics import Tracking, Truth, control_metrics, max_jerk_mps3, percentiles_us

STEP_S = 0.01


def trapezoid_run(*, stop_at_m=100.0, extra_standstill_s=1.0):
    """Accelerate and brake at 1 m/s^2 over exactly 100 m, shifted so that it ends at `stop_at_m`."""
    time_s = np.arange(0.0, 20.0 + extra_standstill_s, STEP_S)
    acceleration = np.where(time_s < 10.0, 1.0, np.where(time_s < 20.0, -1.0, 0.0))
    speed = np.where(time_s < 10.0, time_s, np.clip(20.0 - time_s, 0.0, None))
    position = np.where(time_s < 10.0, time_s**2 / 2, 100.0 - np.clip(20.0 - time_s, 0.0, None) ** 2 / 2)
    zeros = np.zeros_like(time_s)
    return Truth(
        time_s, position + stop_at_m - 100.0, speed, acceleration, zeros + 9.5, zeros + 5.0, zeros + 2.0
    )


def test_stop_error_is_positive_past_the_stop_point():
    truth = trapezoid_run(stop_at_m=100.25)
    metrics = control_metrics(truth, Tracking(truth.time_s, truth.speed_mps), stop_position_m=100.0)
    assert metrics.stop_error_m == pytest.approx(0.25)


def test_trip_time_runs_from_departure_to_standstill():
    truth = trapezoid_run()
    driving = truth.time_s > 0.5
    metrics = control_metrics(
        truth, Tracking(truth.time_s[driving], truth.speed_mps[driving]), stop_position_m=100.0
    )
    assert metrics.trip_time_s == pytest.approx(20.0 - 0.51, abs=2 * STEP_S)


def test_a_train_that_still_moves_has_no_stop_error_and_no_trip_time():
    truth = trapezoid_run()
    cut = Truth(*(getattr(truth, name)[:1500] for name in truth.__dataclass_fields__))
    metrics = control_metrics(cut, Tracking(cut.time_s, cut.speed_mps), stop_position_m=100.0)
    assert metrics.stop_error_m is None
    assert metrics.trip_time_s is None


def test_overspeed_is_against_the_permitted_speed():
    truth = trapezoid_run()
    metrics = control_metrics(truth, Tracking(truth.time_s, truth.speed_mps), stop_position_m=100.0)
    assert metrics.max_overspeed_mps == pytest.approx(10.0 - 9.5, abs=0.02)


def test_constant_speed_error_is_its_own_rms():
    truth = trapezoid_run()
    metrics = control_metrics(truth, Tracking(truth.time_s, truth.speed_mps + 0.04), stop_position_m=100.0)
    assert metrics.rms_speed_error_mps == pytest.approx(0.04)
    assert metrics.max_speed_error_mps == pytest.approx(0.04)


def test_jerk_of_a_ramp_is_its_slope_and_of_a_step_five_times_its_height():
    time_s = np.arange(0.0, 5.0, STEP_S)
    assert max_jerk_mps3(time_s, 0.7 * time_s) == pytest.approx(0.7)
    step = np.where(time_s < 2.5, 0.0, 0.4)
    assert max_jerk_mps3(time_s, step) == pytest.approx(0.4 * 0.5 / 0.1)


def test_jerk_ignores_skipped_cycles():
    time_s = np.arange(0.0, 5.0, STEP_S)
    kept = np.ones(len(time_s), dtype=bool)
    kept[100:103] = False
    assert max_jerk_mps3(time_s[kept], 0.7 * time_s[kept]) == pytest.approx(0.7)


def test_empty_and_tiny_runs_have_no_metrics_rather_than_an_error():
    empty = np.empty(0)
    metrics = control_metrics(Truth(*(empty,) * 7), Tracking(empty, empty), stop_position_m=1.0)
    assert metrics.rms_speed_error_mps is None
    assert percentiles_us(empty)["max"] == 0.0
