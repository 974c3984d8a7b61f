"""The motion of the train and its actuators: the readable version of `plant_sim.kernel`.

    demand -> dead time -> effort curve at this speed -> rate limit -> first-order lag -> adhesion -> rail

The friction brake is the same without a curve. States are integrated with the classical Runge-Kutta
method in fixed sub-steps; orders are constant over a cycle, dead times are whole sub-steps, so all
that enters a sub-step is constant over it. Where the train comes to a stand, or breaks away, inside a
sub-step, the instant is found by linear interpolation (error of the order of jerk times sub-step
squared). `tests/plant_sim/test_dynamics.py` compares whole runs with an adaptive solver.
"""

from __future__ import annotations

from collections import deque
from dataclasses import astuple, dataclass
from typing import NamedTuple

from hil.railway.resistance import specific_to_n
from plant_sim.vehicle import (
    BLOCKED_LAG_S,
    PROMPT_RATE_FACTOR,
    PULSES_OFF_S,
    RATE_LOOP_S,
    Vehicle,
    WheelForces,
    at_the_rail,
)


class Orders(NamedTuple):
    """What the control units order for one cycle."""

    demand: float
    """Effort demand in [-1, 1]."""
    drive_enabled: bool
    """False blocks the converter: no dead time, effort falls at once."""
    pneumatic_n: float
    """Friction brake effort to be reached [N], before its dead time."""
    prompt: bool
    """The friction brake need not keep the service jerk limit."""


@dataclass
class State:
    """State of motion and actuators. Actuator efforts are nominal [N]: what the units believe."""

    position_m: float = 0.0
    speed_mps: float = 0.0
    drive_limited_n: float = 0.0
    """Drive effort after the rate limit; traction positive, electrodynamic brake negative."""
    drive_n: float = 0.0
    pneumatic_limited_n: float = 0.0
    pneumatic_n: float = 0.0
    traction_work_j: float = 0.0
    electrodynamic_work_j: float = 0.0
    pneumatic_work_j: float = 0.0
    resistance_work_j: float = 0.0
    """Davis, curves, tunnels, gradient and disturbance: what the rest of the balance goes into."""
    time_s: float = 0.0
    """Since the start."""


class Forces(NamedTuple):
    """Forces on the train now."""

    wheel: WheelForces
    resistance_n: float
    """Davis, curve, tunnel, gradient and disturbance, positive against the direction of the line."""
    acceleration_mps2: float


def drive_target_n(vehicle: Vehicle, state: State, traction: float, braking: float) -> float:
    """Drive effort that is asked for [N], signed, nominal.

    `traction` in [0, 1] and `braking` in [-1, 0] are the demands after their dead times. The
    electrodynamic brake gives what the friction brake does not give already, up to what it can; both
    are looked at one lag of the drive ahead, when the effort asked for now will be there.
    """
    train = vehicle.train
    speed = abs(state.speed_mps)
    target_n = traction * train.traction_effort_n(speed)
    if braking < 0.0:
        deviations = vehicle.deviations  # the units know their own actuators
        lag_s = train.electrodynamic.time_constant_s * deviations.time_constant_factor
        friction_lag_s = train.pneumatic.time_constant_s * deviations.friction_time_constant_factor
        lead = min(1.0, lag_s / friction_lag_s)
        friction_n = state.pneumatic_n + lead * (state.pneumatic_limited_n - state.pneumatic_n)
        later = speed + braking * train.max_braking_mps2 * lag_s
        missing_n = -braking * train.service_brake_effort_n(speed) - friction_n
        target_n -= min(max(missing_n, 0.0), train.electrodynamic.effort_n(max(later, 0.0)))
    return target_n


def forces(vehicle: Vehicle, state: State, direction: float) -> Forces:
    """Forces for motion in `direction` (+1, -1); 0 is standstill, where nothing accelerates."""
    wheel = at_the_rail(vehicle, state.speed_mps, state.drive_n, state.pneumatic_n)
    track = vehicle.track(state.position_m, state.time_s)
    if direction == 0.0:
        return Forces(wheel, track.gradient_n, 0.0)
    resistance_n = track.gradient_n + direction * (vehicle.davis_n(state.speed_mps) + track.friction_n)
    brakes_n = direction * (wheel.electrodynamic_n + wheel.pneumatic_n)
    return Forces(
        wheel, resistance_n, (wheel.traction_n - brakes_n - resistance_n) / vehicle.effective_mass_kg
    )


def direction_of(vehicle: Vehicle, state: State) -> float:
    """Direction of motion: that of the speed; at standstill that in which the train breaks away, or 0."""
    if state.speed_mps != 0.0:
        return 1.0 if state.speed_mps > 0.0 else -1.0
    surplus_n = _surplus_n(vehicle, state)
    if abs(surplus_n[0]) <= surplus_n[1]:
        return 0.0
    return 1.0 if surplus_n[0] > 0.0 else -1.0


class Dynamics:
    """Integrates one vehicle from standstill; `advance` takes whole sub-steps."""

    def __init__(self, vehicle: Vehicle, position_m: float, substep_s: float, pneumatic_n: float) -> None:
        self.vehicle = vehicle
        self.substep_s = substep_s
        self.state = State(position_m, pneumatic_limited_n=pneumatic_n, pneumatic_n=pneumatic_n)
        factor = vehicle.deviations.dead_time_factor
        train = vehicle.train
        self._traction = _delay_line(train.traction.dead_time_s * factor, substep_s, 0.0)
        self._braking = _delay_line(train.electrodynamic.dead_time_s * factor, substep_s, 0.0)
        self._pneumatic = _delay_line(train.pneumatic.dead_time_s * factor, substep_s, pneumatic_n)

    def advance(self, orders: Orders, substeps: int) -> Forces:
        """Integrate with constant orders; forces at the end."""
        for _ in range(substeps):
            self._traction.append(max(0.0, orders.demand))
            self._braking.append(min(0.0, orders.demand))
            self._pneumatic.append(orders.pneumatic_n)
            delayed = (self._traction[0], self._braking[0], self._pneumatic[0])
            self.state = _substep(self.vehicle, self.state, orders, delayed, self.substep_s)
        return forces(self.vehicle, self.state, direction_of(self.vehicle, self.state))


def delay_substeps(dead_time_s: float, substep_s: float) -> int:
    """Dead time in whole sub-steps."""
    return round(dead_time_s / substep_s)


def _delay_line(dead_time_s: float, substep_s: float, value: float) -> deque[float]:
    length = delay_substeps(dead_time_s, substep_s) + 1
    return deque([value] * length, maxlen=length)


def _surplus_n(vehicle: Vehicle, state: State) -> tuple[float, float]:
    """At standstill: force that moves the train, and what holds it [N]."""
    wheel = at_the_rail(vehicle, 0.0, state.drive_n, state.pneumatic_n)
    track = vehicle.track(state.position_m, state.time_s)
    starting_n = specific_to_n(vehicle.train.starting_resistance_n_per_kn, vehicle.mass_kg)
    return (
        wheel.traction_n - track.gradient_n,
        wheel.pneumatic_n + vehicle.davis_n(0.0) + track.friction_n + starting_n,
    )


def _derivative(
    vehicle: Vehicle, state: State, orders: Orders, delayed: tuple[float, float, float], direction: float
) -> State:
    train = vehicle.train
    nominal_mass_kg = train.effective_mass_kg
    traction, braking, pneumatic_order_n = delayed
    drive = train.electrodynamic if braking < 0.0 else train.traction
    rate = drive.jerk_limit_mps3 * nominal_mass_kg
    target_n = drive_target_n(vehicle, state, traction, braking)
    lag_s = drive.time_constant_s * vehicle.deviations.time_constant_factor
    if not orders.drive_enabled:
        target_n, rate, lag_s = 0.0, rate * PROMPT_RATE_FACTOR, min(lag_s, BLOCKED_LAG_S)
    brake_rate = train.electrodynamic.jerk_limit_mps3 * nominal_mass_kg
    if orders.prompt:
        brake_rate *= PROMPT_RATE_FACTOR
    brake_lag_s = train.pneumatic.time_constant_s * vehicle.deviations.friction_time_constant_factor
    drive_limited_rate = _limited((target_n - state.drive_limited_n) / RATE_LOOP_S, rate)
    drive_rate = (state.drive_limited_n - state.drive_n) / lag_s
    if not orders.drive_enabled and state.drive_n > 0.0:
        drive_limited_rate, drive_rate = -state.drive_limited_n / PULSES_OFF_S, -state.drive_n / PULSES_OFF_S
    now = forces(vehicle, state, direction)
    speed = state.speed_mps if direction != 0.0 else 0.0
    return State(
        position_m=speed,
        speed_mps=now.acceleration_mps2,
        drive_limited_n=drive_limited_rate,
        drive_n=drive_rate,
        pneumatic_limited_n=_limited(
            (pneumatic_order_n - state.pneumatic_limited_n) / RATE_LOOP_S, brake_rate
        ),
        pneumatic_n=(state.pneumatic_limited_n - state.pneumatic_n) / brake_lag_s,
        traction_work_j=now.wheel.traction_n * speed,
        electrodynamic_work_j=now.wheel.electrodynamic_n * direction * speed,
        pneumatic_work_j=now.wheel.pneumatic_n * direction * speed,
        resistance_work_j=now.resistance_n * speed,
        time_s=1.0,
    )


def _substep(
    vehicle: Vehicle, state: State, orders: Orders, delayed: tuple[float, float, float], dt: float
) -> State:
    direction = direction_of(vehicle, state)
    k1 = _derivative(vehicle, state, orders, delayed, direction)
    k2 = _derivative(vehicle, _moved(state, k1, 0.5 * dt), orders, delayed, direction)
    k3 = _derivative(vehicle, _moved(state, k2, 0.5 * dt), orders, delayed, direction)
    k4 = _derivative(vehicle, _moved(state, k3, dt), orders, delayed, direction)
    after = State(
        *(
            s + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d)
            for s, a, b, c, d in zip(
                astuple(state), astuple(k1), astuple(k2), astuple(k3), astuple(k4), strict=True
            )
        )
    )
    if direction * after.speed_mps < 0.0:
        return _come_to_a_stand(state, after, k1, dt)
    if direction == 0.0:
        return _break_away(vehicle, state, after, dt)
    return after


def _moved(state: State, rate: State, dt: float) -> State:
    return State(*(s + dt * r for s, r in zip(astuple(state), astuple(rate), strict=True)))


def _come_to_a_stand(before: State, after: State, rate: State, dt: float) -> State:
    """The train stops inside the sub-step: it stays where its speed was zero."""
    half_s = 0.5 * dt * before.speed_mps / (before.speed_mps - after.speed_mps)  # at half the speed
    after.position_m = before.position_m + before.speed_mps * half_s
    after.speed_mps = 0.0
    after.traction_work_j = before.traction_work_j + rate.traction_work_j * half_s
    after.electrodynamic_work_j = before.electrodynamic_work_j + rate.electrodynamic_work_j * half_s
    after.pneumatic_work_j = before.pneumatic_work_j + rate.pneumatic_work_j * half_s
    after.resistance_work_j = before.resistance_work_j + rate.resistance_work_j * half_s
    return after


def _break_away(vehicle: Vehicle, before: State, after: State, dt: float) -> State:
    """The train stood at the start of the sub-step; it may move for the last part of it."""
    direction = direction_of(vehicle, after)
    if direction == 0.0:
        return after
    surplus_before_n, held_before_n = _surplus_n(vehicle, before)
    surplus_after_n, held_after_n = _surplus_n(vehicle, after)
    missing_n = held_before_n - direction * surplus_before_n
    excess_n = direction * surplus_after_n - held_after_n
    moving_s = dt * excess_n / (excess_n + missing_n)
    excess_mps2 = direction * excess_n / vehicle.effective_mass_kg
    acceleration = forces(vehicle, after, direction).acceleration_mps2 - 0.5 * excess_mps2  # mean
    after.speed_mps = acceleration * moving_s
    return after


def _limited(rate: float, limit: float) -> float:
    return min(limit, max(-limit, rate))
