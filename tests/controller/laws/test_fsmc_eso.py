"""The observer knows what nobody told it, and the law built on it leaves no error and no chatter."""

from __future__ import annotations

import math

import pytest

from controller.laws import Drive, Measurement, Reference
from controller.laws.fsmc_eso import FsmcEso, FsmcEsoParameters
from controller.laws.observer import ExtendedStateObserver

DT = 0.01
STEP = 0.01 / 3.6


class Plant:
    """Dead time, lag, a mass ratio and a disturbance; says what its drive gives if asked."""

    def __init__(self, drive, ratio=1.0, disturbance=lambda t: 0.0, resistance=0.05):
        self.orders = [0.0] * (round(drive.dead_time_s / DT) + 1)
        self.decay = math.exp(-DT / drive.lag_s)
        self.ratio, self.disturbance, self.resistance = ratio, disturbance, resistance
        self.speed = self.effort = self.time = 0.0

    def step(self, order):
        self.orders = [*self.orders[1:], order]
        before, oldest = self.effort, self.orders[0]
        self.effort = oldest + (before - oldest) * self.decay
        mean = 0.5 * (before + self.effort)
        self.speed += DT * (mean / self.ratio - self.resistance + self.disturbance(self.time))
        self.time += DT


def observer(drive, **changes):
    usual = {"bandwidth_per_s": 4.0, "learning_s": 0.0, "limit_mps2": 0.6, "resolution_mps": 0.0}
    return ExtendedStateObserver(drive=drive, dt_s=DT, **{**usual, **changes})


def test_the_observer_finds_a_constant_disturbance_and_the_speed_behind_quantisation():
    drive = Drive(0.1, 0.4)
    plant, eso = Plant(drive, disturbance=lambda t: -0.15), observer(drive)
    eso.correct(0.0, 0.0)
    for _ in range(1500):
        order = 0.4
        eso.predict(order, plant.resistance)
        plant.step(order)
        eso.correct(round(plant.speed / STEP) * STEP, 0.0)
    assert eso.unmodelled_mps2 == pytest.approx(-0.15, abs=0.01)
    assert eso.speed_mps == pytest.approx(plant.speed, abs=STEP)


def test_what_is_learned_under_effort_becomes_a_factor_and_is_right_at_once_when_the_effort_changes():
    drive = Drive(0.0, 0.2)
    plant, eso = Plant(drive, ratio=1.2, resistance=0.0), observer(drive, learning_s=1.5)
    eso.correct(0.0, 0.0)
    for k in range(2000):
        order = 0.8 if k < 1900 else -0.8
        eso.predict(order, 0.0)
        plant.step(order)
        eso.correct(plant.speed, 0.0)
    assert eso.effectiveness == pytest.approx(1.0 / 1.2, abs=0.005)
    assert abs(eso.unmodelled_mps2) < 0.01


@pytest.mark.parametrize("ratio", [0.8, 1.0, 1.2])
@pytest.mark.parametrize(("dead_time_s", "lag_s"), [(0.1, 0.4), (0.05, 0.2)])
@pytest.mark.parametrize("reported", [True, False])
def test_an_unknown_mass_and_gradient_leave_no_error(ratio, dead_time_s, lag_s, reported):
    drive = Drive(dead_time_s, lag_s)
    law = FsmcEso(FsmcEsoParameters(), drive)
    plant = Plant(drive, ratio=ratio, disturbance=lambda t: -0.1)
    for k in range(3000):
        acceleration = 0.6 if k < 1000 else 0.0
        wanted = Reference(0.0, 0.006 * min(k, 1000), acceleration, acceleration)
        measured = round(plant.speed / STEP) * STEP
        effort = plant.effort if reported else None
        seen = Measurement(0.0, measured, -1.3, 1.3, plant.resistance, None, effort)
        plant.step(law.step(wanted, seen, DT) + plant.resistance)
    assert plant.speed == pytest.approx(6.0, abs=0.01)


def test_a_slow_disturbance_is_rejected_without_reversing_the_demand_at_every_step():
    """0.1 sin t on a train of 305 t told to be 252.5 t; FSMC paper, section 5, on a quantised speed."""
    drive = Drive(0.05, 0.2)
    law = FsmcEso(FsmcEsoParameters(), drive)
    plant = Plant(drive, ratio=305.0 / 252.5, disturbance=lambda t: 0.1 * math.sin(t))
    worst, turns, last, slope = 0.0, 0, 0.0, 0.0
    for k in range(6000):
        wanted = Reference(0.0, 10.0, 0.0, 0.0)
        if k == 0:
            plant.speed = 10.0
        seen = Measurement(
            0.0, round(plant.speed / STEP) * STEP, -1.3, 1.3, plant.resistance, None, plant.effort
        )
        demand = law.step(wanted, seen, DT)
        plant.step(demand + plant.resistance)
        if k > 1000:
            worst = max(worst, abs(10.0 - plant.speed))
            if abs(demand - last) > 0.01:
                turns += slope * (demand - last) < 0.0
                slope, last = demand - last, demand
    assert 3.6 * worst < 0.12
    assert turns <= 50.0 / math.pi + 3  # two a period of the disturbance


def test_a_standing_train_is_not_pushed_back_by_its_brake():
    law = FsmcEso(FsmcEsoParameters(), Drive(0.1, 0.4))
    for _ in range(100):
        seen = Measurement(0.0, 0.0, -1.3, 1.0, 0.02, None, -0.5)
        demand = law.step(Reference(0.0, 0.0, 0.0, 0.0), seen, DT)
    assert demand == pytest.approx(0.0, abs=1e-6)


def test_where_the_friction_brake_works_the_law_is_slower():
    tuning = FsmcEsoParameters().tuning(Drive(0.1, 0.4, 0.2, 0.6, 2.0, 0.5))
    assert tuning.slowed(2.0) == 1.0
    assert tuning.slowed(1.25) == pytest.approx(0.5 / 0.65)
    assert tuning.slowed(0.1) == pytest.approx(0.5 / 0.8)


def test_given_keys_win_over_what_follows_from_the_drive():
    drive = Drive(0.1, 0.4)
    assert FsmcEsoParameters().tuning(drive).bandwidth_per_s == pytest.approx(2.5)
    own = FsmcEsoParameters(bandwidth_per_s=2.0, lag_s=0.2, dead_time_s=0.0).tuning(drive)
    assert (own.bandwidth_per_s, own.drive.lag_s, own.drive.dead_time_s) == (2.0, 0.2, 0.0)
    assert own.half_range_s_mps == pytest.approx(0.64 * 0.2)
