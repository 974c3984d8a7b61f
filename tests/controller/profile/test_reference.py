from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.config import ProfileConfig
from controller.profile.plain import plain_profile
from controller.profile.reference import Delay, ReferenceTable

DRIVE = Delay(0.1, 0.4)


@pytest.fixture(scope="module")
def profile(journeys):
    return plain_profile(journeys["cat_linh_la_thanh"], ProfileConfig())


@pytest.fixture(scope="module")
def table(profile):
    return ReferenceTable(profile, drive=DRIVE, start_s=4.0)


def test_reference_follows_the_profile_over_position(profile, table):
    for k in range(300, len(profile.time_s) - 1, 37):
        reference = table.at(float(profile.position_m[k]), 1e3)
        assert reference.speed_mps == pytest.approx(profile.speed_mps[k], abs=2e-3)
        assert reference.acceleration_mps2 == pytest.approx(profile.acceleration_mps2[k], abs=2e-2)


def test_a_late_train_follows_the_same_curve(table):
    assert table.at(400.0, 30.0) == table.at(400.0, 300.0)


def test_the_clock_leads_at_standstill_and_waits_after_the_start(profile, table):
    start = profile.start_m
    assert table.at(start, 0.0).speed_mps == 0.0
    speeds = [table.at(start, 0.5 * k).speed_mps for k in range(20)]
    assert speeds == sorted(speeds)
    assert speeds[4] == pytest.approx(np.interp(2.0, profile.time_s, profile.speed_mps), abs=1e-3)
    assert table.at(start, 4.0) == table.at(start, 100.0)


@given(time_s=st.floats(4.5, 80.0))
def test_plan_time_is_the_inverse_of_plan_position(table, time_s):
    assert table.plan_time_s(table.position_at(time_s), 1e3) == pytest.approx(time_s, abs=2e-2)


@given(position=st.floats(-100.0, 1200.0), since=st.floats(-10.0, 1e4))
def test_reference_is_finite_everywhere(table, position, since):
    assert np.all(np.isfinite(table.at(position, since)))
    assert table.at(position, since).speed_mps >= 0.0


def test_past_the_stop_the_reference_stands(table, profile):
    assert table.at(profile.end_m, 1e3)[1:] == (0.0, 0.0, 0.0)
    assert table.at(profile.end_m + 5.0, 1e3)[1:] == (0.0, 0.0, 0.0)


def test_a_delayed_preview_gives_the_planned_acceleration(profile, table):
    """Dead time, then a first-order lag, of the preview: the planned acceleration."""
    dt = 0.01
    effect, delayed, worst = 0.0, [0.0] * 10, 0.0
    for k in range(-60, int(profile.duration_s / dt) - 300):
        time_s = k * dt
        position = table.position_at(time_s) if time_s >= 4.0 else profile.start_m
        delayed.append(table.at(position, time_s).preview_mps2)
        effect += dt / DRIVE.lag_s * (delayed.pop(0) - effect)
        if time_s > 0.0:
            planned = np.interp(time_s, profile.time_s, profile.acceleration_mps2)
            worst = max(worst, abs(effect - planned))
    assert worst < 0.03  # forward Euler of the lag at 10 ms


def test_preview_comes_before_departure(profile, table):
    assert table.at(profile.start_m, -1.0).preview_mps2 == 0.0
    assert table.at(profile.start_m, -0.02).preview_mps2 > 0.02
    assert table.at(profile.start_m, -0.02).speed_mps == 0.0


def test_the_friction_brake_gets_its_longer_lead_at_the_end_only(profile):
    drive_only = ReferenceTable(profile, drive=DRIVE)
    both = ReferenceTable(
        profile, drive=DRIVE, friction=Delay(0.2, 0.6), friction_share=lambda v: 1.0 if v < 1.0 else 0.0
    )
    assert both.at(500.0, 1e3) == drive_only.at(500.0, 1e3)
    assert both.at(0.5, 1.5) == drive_only.at(0.5, 1.5)  # starting, not braking
    near = profile.end_m - 0.3
    assert both.at(near, 1e3).preview_mps2 > drive_only.at(near, 1e3).preview_mps2 + 0.05  # released sooner


def test_last_braking_begins_where_the_plan_brakes_to_its_stop(profile, table):
    after = profile.time_s > table.braking_from_s + 1.5
    fast = after & (profile.speed_mps > 1.0)
    assert np.all(profile.acceleration_mps2[fast] < -0.1)
    assert 0.7 * profile.duration_s < table.braking_from_s < profile.duration_s - 10.0
