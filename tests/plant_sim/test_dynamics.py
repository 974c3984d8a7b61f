"""Motion: analytic cases, energy balance, standstill, and kernel against readable version."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest

from hil.railway import Line, Train
from plant_sim.compiled import KernelDynamics
from plant_sim.dynamics import Dynamics, Orders
from plant_sim.vehicle import Deviations, Disturbance, Vehicle, at_the_rail

COAST = Orders(0.0, True, 0.0, False)


def test_constant_force_without_resistance_gives_uniform_acceleration(
    ideal: Train, level: Line, scripted: Callable[..., Any]
) -> None:
    run = scripted(Vehicle(ideal, level), ((20.0, 0.6),))
    time_s = 0.01 * np.arange(1, 2001)
    # rate loop 20 ms and drive lag 10 ms delay the force by 30 ms in all
    built_up = time_s > 0.5
    assert np.allclose(run.column("speed_mps")[built_up], 0.6 * (time_s - 0.03)[built_up], atol=1e-6)
    expected_m = 0.3 * (time_s - 0.03) ** 2
    assert np.allclose(run.column("position_m")[built_up], expected_m[built_up], atol=3e-4)


def test_frictionless_coasting_down_a_slope_gains_the_height_lost(
    ideal: Train, slope: Callable[[float], Line], scripted: Callable[..., Any]
) -> None:
    run = scripted(Vehicle(ideal, slope(-10.0)), ((30.0, 0.0),))
    assert run.motions[-1].speed_mps == pytest.approx(9.81e-3 * 10.0 * 30.0, rel=1e-9)
    assert run.motions[-1].position_m == pytest.approx(0.5 * 0.0981 * 900.0, rel=1e-9)


def test_coasting_on_a_slope_lies_between_free_fall_and_its_slowest(
    urban: Train, slope: Callable[[float], Line], scripted: Callable[..., Any]
) -> None:
    vehicle = Vehicle(urban, slope(-20.0))
    run = scripted(vehicle, ((60.0, 0.0),))
    pull = 20.0 * urban.mass_kg * 9.81e-3
    fastest = pull / vehicle.effective_mass_kg * 60.0
    resistance = urban.running_resistance_n(fastest)
    slowest = (pull - resistance) / vehicle.effective_mass_kg * 60.0
    assert slowest < run.motions[-1].speed_mps < fastest


def test_rotating_mass_takes_its_share_of_the_effort(
    ideal: Train, level: Line, scripted: Callable[..., Any]
) -> None:
    heavy = replace(ideal, rotating_mass_factor=0.25)
    plain = scripted(Vehicle(ideal, level), ((10.0, 0.5),)).motions[-1]
    slower = scripted(Vehicle(heavy, level), ((10.0, 0.5),)).motions[-1]
    assert slower.speed_mps == pytest.approx(plain.speed_mps / 1.25, rel=1e-9)


def test_energy_balance_closes_over_a_whole_run(
    cat_linh: Train, cat_linh_line: Line, scripted: Callable[..., Any]
) -> None:
    vehicle = Vehicle(cat_linh, cat_linh_line, Deviations(mass_factor=1.1, davis_factor=1.3))
    run = scripted(vehicle, ((15.0, 1.0), (20.0, 0.4), (20.0, 0.0), (10.0, -0.7), (8.0, 0.5), (5.0, -1.0)))
    for motion in run.motions[::50]:
        kinetic_j = 0.5 * vehicle.effective_mass_kg * motion.speed_mps**2
        balance_j = (
            motion.traction_work_j
            - motion.electrodynamic_work_j
            - motion.pneumatic_work_j
            - motion.resistance_work_j
        )
        assert balance_j == pytest.approx(kinetic_j, abs=1e-5 * run.motions[-1].traction_work_j)


def test_gradient_work_is_the_height_of_the_centre_of_mass(
    ideal: Train, paper_line: Line, scripted: Callable[..., Any]
) -> None:
    straight = replace(paper_line, curves=())
    run = scripted(Vehicle(ideal, straight), ((30.0, 0.4), (35.0, 0.0)))
    end = run.motions[-1]
    assert end.position_m > 450.0 + ideal.length_m  # past the climb of 200 m at 6 permille
    assert end.resistance_work_j == pytest.approx(1.2 * 9.81 * ideal.mass_kg, rel=1e-6)


def test_starting_resistance_holds_until_it_is_overcome(
    ideal: Train, level: Line, scripted: Callable[..., Any]
) -> None:
    sticky = replace(ideal, starting_resistance_n_per_kn=5.0)  # 4905 N of 100 kN
    assert scripted(Vehicle(sticky, level), ((5.0, 0.048),)).motions[-1].position_m == 0.0
    assert scripted(Vehicle(sticky, level), ((5.0, 0.051),)).motions[-1].position_m > 0.5


@pytest.mark.parametrize("permille", [-30.0, 0.0, 30.0])
def test_holding_brake_keeps_the_train_where_it_is(
    urban: Train, slope: Callable[[float], Line], permille: float
) -> None:
    holding_n = urban.pneumatic.holding_effort_n
    dynamics = KernelDynamics(Vehicle(urban, slope(permille)), 100.0, 1e-3, holding_n)
    motion = dynamics.advance(Orders(0.0, True, holding_n, True), 60_000)
    assert (motion.position_m, motion.speed_mps, motion.acceleration_mps2) == (100.0, 0.0, 0.0)


def test_brakes_never_pull_the_train_backwards(
    urban: Train, level: Line, scripted: Callable[..., Any]
) -> None:
    run = scripted(Vehicle(urban, level), ((10.0, 0.8), (30.0, -1.0)))
    assert np.min(run.column("speed_mps")) == 0.0
    assert run.motions[-1].speed_mps == 0.0
    assert run.motions[-1].position_m == np.max(run.column("position_m"))


def test_train_rolls_back_on_a_climb_when_nothing_holds_it(
    urban: Train, slope: Callable[[float], Line], scripted: Callable[..., Any]
) -> None:
    run = scripted(Vehicle(urban, slope(20.0)), ((10.0, 0.0),))
    assert run.motions[-1].speed_mps < -1.0
    assert run.motions[-1].position_m < -5.0


def test_climbing_train_stops_and_rolls_back_through_standstill(
    urban: Train, slope: Callable[[float], Line], scripted: Callable[..., Any]
) -> None:
    run = scripted(Vehicle(urban, slope(20.0)), ((6.0, 1.0), (40.0, 0.0)))
    speed = run.column("speed_mps")
    assert np.max(speed) > 1.5
    assert speed[-1] < -1.0
    assert np.max(np.abs(np.diff(speed))) < 0.02  # no jump at the turning point


def test_rolling_train_is_stopped_by_the_brake_in_either_direction(
    urban: Train, slope: Callable[[float], Line]
) -> None:
    dynamics = KernelDynamics(Vehicle(urban, slope(20.0)), 0.0, 1e-3, 0.0)
    rolling = dynamics.advance(COAST, 5_000)
    standing = dynamics.advance(Orders(-1.0, True, 150_000.0, True), 10_000)
    assert rolling.speed_mps < 0.0
    assert standing.speed_mps == 0.0
    assert standing.position_m < rolling.position_m


def test_low_adhesion_limits_traction_and_is_flagged(
    urban: Train, level: Line, scripted: Callable[..., Any]
) -> None:
    vehicle = Vehicle(urban, level, Deviations(adhesion=0.3))
    run = scripted(vehicle, ((10.0, 1.0), (3.0, 0.0), (3.0, -1.0)))
    dry = scripted(Vehicle(urban, level), ((10.0, 1.0), (3.0, 0.0), (3.0, -1.0)))
    accelerating, braking = run.motions[500], run.motions[-1]
    limit_n = 0.3 * urban.adhesion_limit_n(accelerating.speed_mps)
    assert accelerating.slips
    assert accelerating.traction_effort_n == pytest.approx(limit_n, rel=1e-9)
    assert braking.slides
    both_n = braking.electrodynamic_effort_n + braking.pneumatic_effort_n
    assert both_n <= 0.3 * 2.0 * urban.adhesion_limit_n(braking.speed_mps) * (1 + 1e-9)
    assert not any(motion.slips or motion.slides for motion in dry.motions)


def test_blocked_converter_falls_without_dead_time(urban: Train, level: Line) -> None:
    dynamics = KernelDynamics(Vehicle(urban, level), 0.0, 1e-3, 0.0)
    before = dynamics.advance(Orders(0.8, True, 0.0, False), 5_000)
    after = dynamics.advance(Orders(0.0, False, 0.0, False), 50)
    assert after.traction_effort_n < 0.99 * before.traction_effort_n


def test_point_mass_feels_the_gradient_under_its_front_alone(ideal: Train, paper_line: Line) -> None:
    train = KernelDynamics(Vehicle(ideal, paper_line), 225.0, 1e-3, 50_000.0)
    point = KernelDynamics(Vehicle(ideal, paper_line, point_mass=True), 225.0, 1e-3, 50_000.0)
    weight_n = 9.81e-3 * ideal.mass_kg
    assert point.advance(COAST, 1).resistance_n == pytest.approx(6.0 * weight_n)
    assert train.advance(COAST, 1).resistance_n == pytest.approx(3.0 * weight_n)  # half of it is on the climb


DEVIATED = Deviations(1.15, 0.9, 1.1, 1.2, 1.3, 0.5, 0.35, 1.3, 0.85, 0.7)
GUSTS = Disturbance(0.1, 1.3, 0.4)


@pytest.mark.parametrize("point_mass", [False, True])
@pytest.mark.parametrize("disturbance", [Disturbance(), GUSTS])
@pytest.mark.parametrize("deviations", [Deviations(), DEVIATED])
def test_kernel_equals_the_readable_version(
    cat_linh: Train, cat_linh_line: Line, deviations: Deviations, disturbance: Disturbance, point_mass: bool
) -> None:
    sticky = Vehicle(cat_linh, cat_linh_line, deviations, point_mass, disturbance)
    kernel = KernelDynamics(sticky, 480.0, 1e-3, 70_000.0)
    readable = Dynamics(sticky, 480.0, 1e-3, 70_000.0)
    for orders, substeps in (
        (Orders(0.0, True, 70_000.0, True), 50),
        (Orders(0.9, True, 0.0, True), 1200),
        (Orders(-0.7, True, 30_000.0, False), 900),
        (Orders(0.5, True, 0.0, False), 300),
        (Orders(0.0, False, 120_000.0, True), 1500),
        (Orders(0.0, True, 0.0, True), 3000),  # rolls back on 11 permille
    ):
        motion = kernel.advance(orders, substeps)
        forces = readable.advance(orders, substeps)
        state = (*motion[:10], motion.time_s)
        assert state == pytest.approx(astuple(readable.state), rel=1e-12, abs=1e-12)
        assert motion.acceleration_mps2 == pytest.approx(forces.acceleration_mps2, rel=1e-12, abs=1e-12)
        assert motion[11:15] == pytest.approx((*forces.wheel[:3], forces.resistance_n), rel=1e-12, abs=1e-9)
        assert (bool(motion.slips), bool(motion.slides)) == (forces.wheel.slips, forces.wheel.slides)
    assert motion.speed_mps != 0.0


def test_halving_the_substep_changes_nothing_that_counts(cat_linh: Train, cat_linh_line: Line) -> None:
    vehicle = Vehicle(cat_linh, cat_linh_line)
    coarse, fine = (KernelDynamics(vehicle, 0.0, step, 0.0) for step in (1e-3, 5e-4))
    for orders, seconds in (
        (Orders(0.9, True, 0.0, False), 20),
        (COAST, 10),
        (Orders(-0.7, True, 60_000.0, False), 20),
    ):
        a, b = coarse.advance(orders, 1000 * seconds), fine.advance(orders, 2000 * seconds)
        assert a.position_m == pytest.approx(b.position_m, abs=1e-4)
        assert a.speed_mps == pytest.approx(b.speed_mps, abs=1e-5)


def test_warm_up_has_no_side_effect(urban: Train, level: Line) -> None:
    dynamics = KernelDynamics(Vehicle(urban, level), 5.0, 1e-3, 80_000.0)
    untouched = KernelDynamics(Vehicle(urban, level), 5.0, 1e-3, 80_000.0)
    dynamics.warm_up()
    orders = Orders(0.7, True, 0.0, False)
    assert dynamics.advance(orders, 3000) == untouched.advance(orders, 3000)


@pytest.mark.parametrize("remaining_n", [2e-315, 5e-324, 1e-12])
def test_a_brake_released_long_ago_does_not_slide(ideal: Train, level: Line, remaining_n: float) -> None:
    """Its effort has decayed to a subnormal number, where rounding is larger than the number."""
    vehicle = Vehicle(ideal, level)
    for speed_mps in (0.0, 10.0, 28.0):
        assert not at_the_rail(vehicle, speed_mps, 0.0, remaining_n).slides
    coasting = KernelDynamics(vehicle, 0.0, 0.001, remaining_n)
    coasting.advance(COAST, 10)
    assert not coasting.motion.slides


def test_a_disturbance_moves_a_free_train_by_its_double_integral(ideal: Train, level: Line) -> None:
    amplitude, frequency, phase = 0.1, 0.7, 0.5
    vehicle = Vehicle(ideal, level, disturbance=Disturbance(amplitude, frequency, phase))
    dynamics = KernelDynamics(vehicle, 0.0, 1e-3, 0.0)
    dynamics.advance(Orders(0.2, True, 0.0, False), 10_000)
    before = dynamics.advance(COAST, 1_000)  # the effort has died out: the disturbance is alone
    after = dynamics.advance(COAST, 20_000)

    def antiderivative(time_s: float) -> float:
        return -amplitude / frequency * np.cos(frequency * time_s + phase)

    gained = antiderivative(after.time_s) - antiderivative(before.time_s)
    assert after.time_s == pytest.approx(31.0)
    assert after.speed_mps - before.speed_mps == pytest.approx(gained, abs=1e-9)
    now = amplitude * np.sin(frequency * after.time_s + phase)
    assert after.acceleration_mps2 == pytest.approx(now, abs=1e-9)


def test_a_disturbance_does_not_move_a_train_that_its_brake_holds(urban: Train, level: Line) -> None:
    vehicle = Vehicle(urban, level, disturbance=Disturbance(0.3, 1.0))
    dynamics = KernelDynamics(vehicle, 100.0, 1e-3, urban.pneumatic.holding_effort_n)
    motion = dynamics.advance(Orders(0.0, True, urban.pneumatic.holding_effort_n, True), 20_000)
    assert (motion.position_m, motion.speed_mps, motion.acceleration_mps2) == (100.0, 0.0, 0.0)


def test_energy_balance_closes_under_a_disturbance(
    urban: Train, level: Line, scripted: Callable[..., Any]
) -> None:
    vehicle = Vehicle(urban, level, disturbance=Disturbance(0.1, 0.9))
    motion = scripted(vehicle, ((15.0, 0.8), (20.0, 0.0), (4.0, -0.4))).motions[-1]
    kinetic_j = 0.5 * vehicle.effective_mass_kg * motion.speed_mps**2
    spent_j = motion.electrodynamic_work_j + motion.pneumatic_work_j + motion.resistance_work_j
    assert motion.traction_work_j - spent_j == pytest.approx(kinetic_j, rel=1e-5)


def test_gradient_factor_scales_slopes_and_leaves_curves(ideal: Train, paper_line: Line) -> None:
    steeper = Deviations(gradient_factor=1.2)
    weight_n = 9.81e-3 * ideal.mass_kg

    def resistance_n(front_m: float, deviations: Deviations) -> float:
        vehicle = Vehicle(ideal, paper_line, deviations)
        return KernelDynamics(vehicle, front_m, 1e-3, 50_000.0).advance(COAST, 1).resistance_n

    on_the_climb = resistance_n(300.0, steeper)
    assert on_the_climb == pytest.approx(1.2 * 6.0 * weight_n)
    assert paper_line.mean_specific_resistance(1080.0, 50.0) == pytest.approx(1.2)  # a curve, level
    moving = Vehicle(ideal, paper_line, steeper)
    assert moving.track(1080.0).friction_n == pytest.approx(1.2 * weight_n)
    assert moving.track(1080.0).gradient_n == pytest.approx(0.0, abs=1e-9)


def test_friction_brake_factor_leaves_the_motors_alone(urban: Train, level: Line) -> None:
    weak = Vehicle(urban, level, Deviations(brake_factor=0.9, friction_brake_factor=0.8))
    wheel = at_the_rail(weak, 5.0, -50_000.0, 40_000.0)
    assert wheel.electrodynamic_n == pytest.approx(0.9 * 50_000.0)
    assert wheel.pneumatic_n == pytest.approx(0.72 * 40_000.0)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_friction_time_constant_factor_is_that_of_the_friction_brake_alone(
    urban: Train, level: Line, factor: float
) -> None:
    vehicle = Vehicle(urban, level, Deviations(friction_time_constant_factor=factor))
    dynamics = KernelDynamics(vehicle, 0.0, 1e-3, 0.0)
    order_n = 1_000.0  # so small that the rate limit is passed in no time
    dynamics.advance(Orders(0.0, True, order_n, True), round(1000 * urban.pneumatic.dead_time_s))
    lag_s = urban.pneumatic.time_constant_s * factor
    motion = dynamics.advance(Orders(0.0, True, order_n, True), round(1000 * (lag_s + 0.02)))
    assert motion.pneumatic_n == pytest.approx(order_n * (1.0 - np.exp(-1.0)), rel=0.03)
