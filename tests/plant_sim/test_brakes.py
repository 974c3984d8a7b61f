"""Blending of electrodynamic and friction brake: the sum is what was asked for, and smooth."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hil.railway import Line, load_train
from hil.railway.library import find_train
from plant_sim.compiled import KernelDynamics
from plant_sim.vehicle import Deviations, Vehicle

TRAINS = ("urban_4car_80m", "cat_linh_4car", "metro_smc_252t", "metro_smc_305t", "mainline_fuzzy_pid")
COMFORT_JERK_MPS3 = 1.0


def jerk_mps3(acceleration: np.ndarray) -> np.ndarray:
    """0.2 s moving average of the acceleration, differenced over 0.1 s; cycles of 10 ms."""
    average = np.convolve(acceleration, np.full(20, 0.05), mode="valid")
    return np.abs(average[10:] - average[:-10]) / 0.1


def ramp(peak: float) -> tuple[tuple[float, float], ...]:
    """From no demand to braking with `peak` within 2 s."""
    return tuple((0.02, -peak * k / 100.0) for k in range(100))


@pytest.mark.parametrize("name", TRAINS)
@pytest.mark.parametrize("peak", [0.3, 0.6, 0.9])
def test_handing_over_to_the_friction_brake_is_smooth(
    name: str, peak: float, level: Line, scripted: Callable[..., Any]
) -> None:
    train = load_train(find_train(name))
    run = scripted(Vehicle(train, level), ((14.0, 0.9), (3.0, 0.0), *ramp(peak), (100.0, -peak)))
    speed = run.column("speed_mps")
    stop = int(np.flatnonzero(speed > 0.0)[-1])
    assert stop < len(speed) - 1
    begin = 1700  # braking begins
    assert np.max(jerk_mps3(run.column("acceleration_mps2")[begin:stop])) < COMFORT_JERK_MPS3
    settled = slice(begin + 400, stop)
    total = run.column("electrodynamic_effort_n") + run.column("pneumatic_effort_n")
    wanted = peak * train.service_brake_effort_n()
    assert np.max(run.column("electrodynamic_effort_n")) > 0.6 * min(
        wanted, train.electrodynamic.effort_n(8.0)
    )
    assert run.motions[stop].pneumatic_effort_n == pytest.approx(wanted, rel=0.02)
    # Within 5 %: what the lead of the motors by one lag leaves over of the hand-over.
    assert np.max(np.abs(total[settled] / wanted - 1.0)) < 0.05


def test_stop_that_eases_off_keeps_the_jerk_limit_through_standstill(
    urban: Any, level: Line, scripted: Callable[..., Any]
) -> None:
    """A driver who halves the demand as the train slows down, to 0.12 of full service at the end."""
    vehicle = Vehicle(urban, level)
    dynamics = KernelDynamics(vehicle, 0.0, 1e-3, 0.0)
    runs = [scripted(vehicle, ((10.0, 0.9), (2.0, 0.0), *ramp(0.6)), dynamics=dynamics)]
    while dynamics.motion.speed_mps > 0.0:
        demand = -min(0.6, 0.12 + 0.2 * max(0.0, dynamics.motion.speed_mps - 0.3))
        runs.append(scripted(vehicle, ((0.01, demand),), dynamics=dynamics))
    runs.append(scripted(vehicle, ((1.0, -0.2),), dynamics=dynamics))
    acceleration = np.concatenate([run.column("acceleration_mps2") for run in runs])
    assert np.max(jerk_mps3(acceleration[1000:])) < COMFORT_JERK_MPS3


def test_motors_give_what_they_can_before_friction_does(
    urban: Any, level: Line, scripted: Callable[..., Any]
) -> None:
    run = scripted(Vehicle(urban, level), ((20.0, 0.9), (4.0, -0.5)))
    braking = run.motions[-1]
    assert braking.speed_mps > 8.0
    assert braking.electrodynamic_effort_n == pytest.approx(0.5 * urban.service_brake_effort_n(), rel=0.01)
    assert braking.pneumatic_effort_n < 1.0


def test_weak_brakes_deliver_their_factor_of_what_is_asked(
    urban: Any, level: Line, scripted: Callable[..., Any]
) -> None:
    script = ((20.0, 0.9), (4.0, -0.5))
    nominal = scripted(Vehicle(urban, level), script).motions[-1]
    weak = scripted(Vehicle(urban, level, Deviations(brake_factor=0.8)), script).motions[-1]
    assert weak.electrodynamic_effort_n == pytest.approx(0.8 * nominal.electrodynamic_effort_n, rel=1e-6)
