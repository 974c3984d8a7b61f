"""The unit against a small train of its own: what a passenger and a signaller would measure."""

from __future__ import annotations

import numpy as np
import pytest

from controller.modes import Mode
from controller.supervision import Supervision

each_law = pytest.mark.parametrize("law", ["fuzzy_d", "pid"])
each_line = pytest.mark.parametrize("scenario", ["cat_linh_la_thanh", "fuzzy_d_2km", "la_thanh_cat_linh"])


@each_law
@each_line
def test_the_nominal_train_meets_every_target(loop, scenario, law):
    driven = loop(scenario, law=law)
    run = driven.run(driven.journey.time_s + 30.0)
    assert run.mode[-1] == Mode.HOLD
    assert set(run.supervision) == {Supervision.NORMAL}
    assert abs(run.stop_error_m) <= 0.02
    assert run.rms_error_mps <= 0.02
    assert run.overspeed_mps <= 0.0
    assert run.jerk_mps3 <= 1.0
    assert run.standstill_mps2 <= 0.2
    assert abs(run.trip_time_s - driven.journey.time_s) <= 2.0


@each_law
@pytest.mark.parametrize("seed", range(6))
def test_stop_and_tracking_hold_for_other_masses_and_brakes(loop, law, seed):
    """Mass and brake within 20 %, traction within 10 %, one odometry frame in a hundred lost."""
    random = np.random.default_rng(seed)
    corners = [(1.2, 0.8), (0.8, 1.2)]
    mass, brake = corners[seed] if seed < 2 else random.uniform(0.8, 1.2, 2)
    scenario = ("cat_linh_la_thanh", "fuzzy_d_2km")[seed % 2]
    driven = loop(
        scenario, law=law, mass_factor=mass, brake_factor=brake,
        traction_factor=random.uniform(0.9, 1.1), lost_fraction=0.01, seed=seed,
    )  # fmt: skip
    run = driven.run(driven.journey.time_s + 40.0)
    assert run.mode[-1] == Mode.HOLD
    assert abs(run.stop_error_m) <= 0.25
    assert run.rms_error_mps <= 0.08
    assert run.overspeed_mps <= 0.3
    assert abs(run.trip_time_s - driven.journey.time_s) <= 3.0


@each_law
@pytest.mark.parametrize(("lag", "dead"), [(0.25, 0.05), (0.6, 0.2)])
def test_the_loop_is_stable_for_other_drives(loop, law, lag, dead):
    driven = loop("cat_linh_la_thanh", law=law, lag_s=lag, dead_time_s=dead)
    run = driven.run(driven.journey.time_s + 40.0)
    assert run.mode[-1] == Mode.HOLD
    assert abs(run.stop_error_m) <= 0.25
    assert run.rms_error_mps <= 0.1


def test_the_plan_alone_is_not_what_drives_the_train(loop):
    """Without feedback the same deviations miss the stop by metres: the tests above do test the law."""
    driven = loop("cat_linh_la_thanh", mass_factor=1.1, brake_factor=0.9)
    driven.unit._law.step = lambda reference, measurement, dt: reference.preview_mps2
    run = driven.run(driven.journey.time_s + 10.0)
    assert abs(run.stop_error_m) > 1.0


@pytest.mark.parametrize("at_s", [6.0, 30.0, 75.0])
def test_a_lost_permission_ends_in_standstill_before_long(loop, at_s):
    def lose(driven):
        if driven.cycle == round(at_s / 0.01):
            driven.bus["ATP_Permission"].silent = True

    driven = loop("cat_linh_la_thanh")
    run = driven.run(at_s + 30.0, each=lose)
    after = run.time_s >= at_s
    assert np.all(run.demand[after] <= 0.0)
    assert run.speed_mps[-1] == 0.0
    assert Supervision.PERMISSION_LOST in run.supervision[after]
    assert run.holding[-1]


def test_after_a_short_loss_of_permission_the_train_still_reaches_its_stop(loop):
    def lose(driven):
        driven.bus["ATP_Permission"].silent = 3000 <= driven.cycle < 3400

    driven = loop("cat_linh_la_thanh")
    run = driven.run(driven.journey.time_s + 60.0, each=lose)
    assert run.mode[-1] == Mode.HOLD
    assert abs(run.stop_error_m) <= 0.05
    assert Mode.DEGRADED in run.mode
    assert run.trip_time_s > driven.journey.time_s
    assert run.overspeed_mps <= 0.3


def test_after_a_full_stop_on_the_way_the_train_goes_on(loop):
    def lose(driven):
        driven.bus["ATP_Permission"].values["DepartureAuthorised"] = int(not 3000 <= driven.cycle < 5500)

    driven = loop("cat_linh_la_thanh")
    run = driven.run(driven.journey.time_s + 90.0, each=lose)
    assert np.any((run.speed_mps == 0.0) & (run.position_m > 50.0) & (run.position_m < 900.0))
    assert run.mode[-1] == Mode.HOLD
    assert abs(run.stop_error_m) <= 0.05
    assert run.overspeed_mps <= 0.3


def test_an_emergency_stop_ends_at_standstill_and_the_journey_goes_on_when_withdrawn(loop):
    def order(driven):
        driven.bus["ATP_Permission"].values["EmergencyStop"] = int(3000 <= driven.cycle < 3300)

    driven = loop("cat_linh_la_thanh")
    run = driven.run(driven.journey.time_s + 90.0, each=order)
    assert Mode.EMERGENCY in run.mode
    assert run.mode[-1] == Mode.HOLD
    assert abs(run.stop_error_m) <= 0.05


def test_dead_odometry_brings_the_train_to_a_stand(loop):
    def lose(driven):
        driven.bus["ODO_Motion"].silent = driven.cycle >= 3000

    run = loop("cat_linh_la_thanh").run(60.0, each=lose)
    after = run.time_s >= 30.0
    assert np.all(run.demand[after] <= 0.0)
    assert run.mode[-1] == Mode.EMERGENCY
    assert run.speed_mps[-1] == 0.0


def test_the_same_seed_gives_the_same_run(loop):
    one = loop("cat_linh_la_thanh", lost_fraction=0.1, seed=3).run(40.0)
    two = loop("cat_linh_la_thanh", lost_fraction=0.1, seed=3).run(40.0)
    np.testing.assert_array_equal(one.demand, two.demand)
    np.testing.assert_array_equal(one.position_m, two.position_m)
