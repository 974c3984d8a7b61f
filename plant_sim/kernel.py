# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""The compiled form of `plant_sim.dynamics`: plain functions over plain numbers and records.

Everything here mirrors a function of `dynamics` or `vehicle` by name; read those for the why. The
tests hold both to the same run. `p` is a record of `compiled.PARAMETERS`, `s` one of
`compiled.STATE`; `track` has the rows edges, integral of the gradient, integral of curves and
tunnels, gradient, curves and tunnels. No constant comes from another module: numba's cache would not
notice its change.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from hil.railway.track import integral_at as _integral_at

_integral = njit(cache=True)(_integral_at)


@njit(cache=True)
def _curve(max_n, power_w, points, speed):
    effort = max_n
    if speed * effort > power_w:
        effort = power_w / speed
    if len(points):
        effort = min(effort, np.interp(speed, points[:, 0], points[:, 1]))
    return effort


@njit(cache=True)
def _track_forces(p, track, front):
    weight = 1e-3 * p.weight_n
    edges = track[0]
    if p.length_m > 0.0:
        rear = front - p.length_m
        gradient = (_integral(edges, track[1], front) - _integral(edges, track[1], rear)) / p.length_m
        friction = (_integral(edges, track[2], front) - _integral(edges, track[2], rear)) / p.length_m
        return weight * gradient, weight * friction
    index = np.searchsorted(edges, front, side="right") - 1
    if index < 0:
        return 0.0, 0.0
    return weight * track[3, index], weight * track[4, index]


@njit(cache=True)
def _with_disturbance(p, gradient, time):
    if p.disturbance_n != 0.0:
        gradient -= p.disturbance_n * np.sin(p.disturbance_radps * time + p.disturbance_rad)
    return gradient


@njit(cache=True)
def _at_the_rail(p, speed, drive, pneumatic):
    limit = p.adhesion * (0.161 + 7.5 / (abs(speed) * 3.6 + 44.0)) * p.weight_n
    on_motored = p.motored * limit
    wanted_traction = p.traction_factor * max(0.0, drive)
    wanted_brake = p.brake_factor * max(0.0, -drive)
    wanted_friction = p.friction_factor * pneumatic
    traction = min(wanted_traction, on_motored)
    brake = min(wanted_brake, on_motored)
    friction = min(p.motored * wanted_friction, on_motored - brake)
    friction += min((1.0 - p.motored) * wanted_friction, (1.0 - p.motored) * limit)
    slides = wanted_brake + wanted_friction > brake + friction + p.slide_margin_n
    return traction, brake, friction, wanted_traction > traction, slides


@njit(cache=True)
def _resistance(p, gradient, friction, speed, direction):
    if direction == 0.0:
        return gradient
    speed = abs(speed)
    davis = p.davis_a_n + p.davis_b * speed + p.davis_c * speed * speed
    return gradient + direction * (davis + friction)


@njit(cache=True)
def _surplus(p, track, time, position, drive, pneumatic):
    traction, _, brake, _, _ = _at_the_rail(p, 0.0, drive, pneumatic)
    gradient, friction = _track_forces(p, track, position)
    gradient = _with_disturbance(p, gradient, time)
    return traction - gradient, brake + p.davis_a_n + friction + p.starting_n


@njit(cache=True)
def _direction(p, track, time, position, speed, drive, pneumatic):
    if speed != 0.0:
        return 1.0 if speed > 0.0 else -1.0
    surplus, held = _surplus(p, track, time, position, drive, pneumatic)
    if abs(surplus) <= held:
        return 0.0
    return 1.0 if surplus > 0.0 else -1.0


@njit(cache=True)
def _limited(rate, limit):
    return min(limit, max(-limit, rate))


@njit(cache=True)
def _derivative(p, track, traction_points, brake_points, order, direction, t, x, v, fl, f, pl, pn):
    traction, braking, pneumatic_order, enabled, brake_rate = order
    speed = abs(v)
    target = 0.0
    if traction > 0.0:
        target = traction * _curve(p.traction_max_n, p.traction_power_w, traction_points, speed)
    lag = p.traction_lag_s
    rate = p.traction_rate
    if braking < 0.0:
        soon = pn + min(1.0, p.electrodynamic_lag_s / p.pneumatic_lag_s) * (pl - pn)
        later = max(0.0, speed + braking * p.max_braking_mps2 * p.electrodynamic_lag_s)
        available = _curve(p.electrodynamic_max_n, p.electrodynamic_power_w, brake_points, later)
        fade = (later - p.fade_end_mps) / (p.fade_start_mps - p.fade_end_mps)
        available *= min(1.0, max(0.0, fade))
        target -= min(max(-braking * p.service_effort_n - soon, 0.0), available)
        lag = p.electrodynamic_lag_s
        rate = p.electrodynamic_rate
    if not enabled:
        target = 0.0
        rate *= p.prompt_rate_factor
        lag = min(lag, p.blocked_lag_s)
    limited_rate = _limited((target - fl) / p.rate_loop_s, rate)
    drive_rate = (fl - f) / lag
    if not enabled and f > 0.0:
        limited_rate = -fl / p.pulses_off_s
        drive_rate = -f / p.pulses_off_s
    wheel = _at_the_rail(p, v, f, pn)
    gradient, friction = _track_forces(p, track, x)
    gradient = _with_disturbance(p, gradient, t)
    resistance = _resistance(p, gradient, friction, v, direction)
    if direction == 0.0:
        v = 0.0
        acceleration = 0.0
    else:
        acceleration = (wheel[0] - direction * (wheel[1] + wheel[2]) - resistance) / p.effective_mass_kg
    return (
        v,
        acceleration,
        limited_rate,
        drive_rate,
        _limited((pneumatic_order - pl) / p.rate_loop_s, brake_rate),
        (pl - pn) / p.pneumatic_lag_s,
        wheel[0] * v,
        wheel[1] * direction * v,
        wheel[2] * direction * v,
        resistance * v,
    )


@njit(cache=True)
def _substep(s, p, track, traction_points, brake_points, order):
    dt = p.substep_s
    half = 0.5 * dt
    x, v, fl, f, pl, pn = (
        s.position_m, s.speed_mps, s.drive_limited_n, s.drive_n, s.pneumatic_limited_n, s.pneumatic_n,
    )  # fmt: skip
    t = s.time_s
    s.time_s = t + dt
    direction = _direction(p, track, t, x, v, f, pn)
    a = _derivative(p, track, traction_points, brake_points, order, direction, t, x, v, fl, f, pl, pn)
    b = _derivative(
        p, track, traction_points, brake_points, order, direction,
        t + half, x + half * a[0], v + half * a[1], fl + half * a[2],
        f + half * a[3], pl + half * a[4], pn + half * a[5],
    )  # fmt: skip
    c = _derivative(
        p, track, traction_points, brake_points, order, direction,
        t + half, x + half * b[0], v + half * b[1], fl + half * b[2],
        f + half * b[3], pl + half * b[4], pn + half * b[5],
    )  # fmt: skip
    d = _derivative(
        p, track, traction_points, brake_points, order, direction,
        t + dt, x + dt * c[0], v + dt * c[1], fl + dt * c[2],
        f + dt * c[3], pl + dt * c[4], pn + dt * c[5],
    )  # fmt: skip
    sixth = dt / 6.0
    s.drive_limited_n = fl + sixth * (a[2] + 2.0 * b[2] + 2.0 * c[2] + d[2])
    s.drive_n = f + sixth * (a[3] + 2.0 * b[3] + 2.0 * c[3] + d[3])
    s.pneumatic_limited_n = pl + sixth * (a[4] + 2.0 * b[4] + 2.0 * c[4] + d[4])
    s.pneumatic_n = pn + sixth * (a[5] + 2.0 * b[5] + 2.0 * c[5] + d[5])
    after = v + sixth * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
    if direction * after < 0.0:  # comes to a stand
        half_s = 0.5 * dt * v / (v - after)
        s.position_m = x + v * half_s
        s.speed_mps = 0.0
        s.traction_work_j += a[6] * half_s
        s.electrodynamic_work_j += a[7] * half_s
        s.pneumatic_work_j += a[8] * half_s
        s.resistance_work_j += a[9] * half_s
        return
    s.position_m = x + sixth * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
    s.speed_mps = after
    s.traction_work_j += sixth * (a[6] + 2.0 * b[6] + 2.0 * c[6] + d[6])
    s.electrodynamic_work_j += sixth * (a[7] + 2.0 * b[7] + 2.0 * c[7] + d[7])
    s.pneumatic_work_j += sixth * (a[8] + 2.0 * b[8] + 2.0 * c[8] + d[8])
    s.resistance_work_j += sixth * (a[9] + 2.0 * b[9] + 2.0 * c[9] + d[9])
    if direction == 0.0:  # may break away inside the sub-step
        surplus_before, held_before = _surplus(p, track, t, x, f, pn)
        surplus, held = _surplus(p, track, s.time_s, x, s.drive_n, s.pneumatic_n)
        if abs(surplus) > held:
            direction = 1.0 if surplus > 0.0 else -1.0
            missing = held_before - direction * surplus_before
            excess = direction * surplus - held
            mean = direction * (p.starting_n + 0.5 * excess) / p.effective_mass_kg
            s.speed_mps = mean * dt * excess / (excess + missing)


@njit(cache=True)
def advance(
    states, parameters, lines, track, traction_points, brake_points,
    demand, enabled, pneumatic_order, prompt, substeps,
):  # fmt: skip
    """Integrate so many sub-steps with constant orders; state and forces at the end are in `states[0]`."""
    s = states[0]
    p = parameters[0]
    size = lines.shape[1]
    brake_rate = p.electrodynamic_rate * (p.prompt_rate_factor if prompt else 1.0)
    head = s.delay_head
    for _ in range(substeps):
        head = (head + 1) % size
        lines[0, head] = demand
        lines[1, head] = pneumatic_order
        order = (
            max(0.0, lines[0, (head - p.traction_delay) % size]),
            min(0.0, lines[0, (head - p.electrodynamic_delay) % size]),
            lines[1, (head - p.pneumatic_delay) % size],
            enabled,
            brake_rate,
        )
        _substep(s, p, track, traction_points, brake_points, order)
    s.delay_head = head
    direction = _direction(p, track, s.time_s, s.position_m, s.speed_mps, s.drive_n, s.pneumatic_n)
    wheel = _at_the_rail(p, s.speed_mps, s.drive_n, s.pneumatic_n)
    gradient, friction = _track_forces(p, track, s.position_m)
    gradient = _with_disturbance(p, gradient, s.time_s)
    resistance = _resistance(p, gradient, friction, s.speed_mps, direction)
    s.acceleration_mps2 = 0.0
    if direction != 0.0:
        s.acceleration_mps2 = (
            wheel[0] - direction * (wheel[1] + wheel[2]) - resistance
        ) / p.effective_mass_kg
    s.traction_effort_n = wheel[0]
    s.electrodynamic_effort_n = wheel[1]
    s.pneumatic_effort_n = wheel[2]
    s.resistance_n = resistance
    s.slips = 1.0 if wheel[3] else 0.0
    s.slides = 1.0 if wheel[4] else 0.0
