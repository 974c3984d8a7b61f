"""The fastest profile: one sweep forward with traction, one backward with braking, at every node the lowest.

The speed reached at the end of a stage grows with the speed at its beginning, so of all feasible profiles
there is one that is highest everywhere. It takes least time, which proves that less is impossible.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from controller.profile.problem import Infeasible, Problem
from controller.profile.profile import Floats
from controller.profile.solution import Solution
from controller.profile.stages import NO_LIMIT, Stages, speed_effort, stage_force, stages_of

if TYPE_CHECKING:
    from collections.abc import Callable

RELAXATION = 1.01
"""How much a limit is raised to see what it costs."""
SLOWEST = 1e-13
"""Least y = v^2/2 [m^2/s^2] of a moving train."""
OK, CANNOT_START, CANNOT_CLIMB, CANNOT_BRAKE, CANNOT_REACH = range(5)


def fastest_profile(problem: Problem) -> Solution:
    """The profile of least time within all limits. Infeasible if it cannot climb, brake or get away."""
    began = time.perf_counter()
    y = fastest_y(problem, stages_of(problem))
    speed = np.sqrt(2.0 * y)
    least = trip_time_s(np.diff(problem.position_m), y)
    spent = time.perf_counter() - began
    return Solution.of_speeds(problem, speed, solver="fastest", min_time_s=least, solve_time_s=spent)


def fastest_y(problem: Problem, stages: Stages) -> Floats:
    """Y = v^2/2 at the nodes of the fastest profile; Infeasible if there is none."""
    y, fault, node = sweep(stages)
    if fault == OK:
        return y
    place = f"{problem.position_m[node]:.0f} m"
    here = f"{np.sqrt(2.0 * max(y[node], 0.0)):.1f} m/s"
    text, binding = {
        CANNOT_START: (
            f"the train enters at {problem.start_speed_mps:g} m/s, but must have {here} to brake in time",
            "braking",
        ),
        CANNOT_CLIMB: (f"the train cannot climb at {place}", "traction"),
        CANNOT_BRAKE: (f"the train cannot brake at {place}", "braking"),
        CANNOT_REACH: (
            f"the train shall leave at {problem.end_speed_mps:g} m/s, but reaches {here} at most",
            "end speed",
        ),
    }[fault]
    raise Infeasible(f"profile: {text}", min_time_s=float("inf"), binding=binding)


def too_short(problem: Problem, stages: Stages, min_time_s: float) -> Infeasible:
    """The error of a trip time below the least possible one, with the limit that costs most."""
    binding = binding_limit(stages, min_time_s)
    return Infeasible(
        f"profile: {problem.time_s:g} s must be at least {np.ceil(min_time_s * 100.0) / 100.0:.2f} s, the "
        f"least time within the limits; what binds most is the {binding}",
        min_time_s=min_time_s,
        binding=binding,
    )


def binding_limit(stages: Stages, min_time_s: float) -> str:
    """The limit of which one per cent more would shorten the least time most."""
    more = RELAXATION

    def effort(force: float, power: float) -> Stages:
        old = stages.traction
        return stages._replace(
            traction=old._replace(force=old.force * force, power=old.power * power, table=old.table * power)
        )

    relaxed: dict[str, Callable[[], Stages]] = {
        "speed limit": lambda: stages._replace(top=stages.top * more**2),
        "acceleration": lambda: stages._replace(accelerate=stages.accelerate * more),
        "deceleration": lambda: stages._replace(decelerate=stages.decelerate * more),
        "traction force": lambda: effort(more, 1.0),
        "traction power": lambda: effort(1.0, more),
        "braking force": lambda: stages._replace(
            brake=stages.brake * more,
            regeneration=stages.regeneration._replace(
                force=stages.regeneration.force * more,
                power=stages.regeneration.power * more,
                table=stages.regeneration.table * more,
            ),
        ),
    }
    gains: dict[str, float] = {}
    for name, make in relaxed.items():
        y, fault, _ = sweep(make())
        gains[name] = min_time_s - trip_time_s(stages.dx, y) if fault == OK else 0.0
    return max(gains, key=lambda name: gains[name])


@njit(cache=True)
def trip_time_s(dx: Floats, y: Floats) -> float:
    """Trip time [s] through these y = v^2/2 at the nodes, with constant acceleration between."""
    total = 0.0
    before = np.sqrt(2.0 * y[0])
    for k in range(dx.shape[0]):
        after = np.sqrt(2.0 * y[k + 1])
        total += 2.0 * dx[k] / (before + after)
        before = after
    return total


@njit(cache=True)
def stage_cost(stages: Stages, y: Floats) -> float:
    """Energy at the line per mass [J/kg] of a profile."""
    total = 0.0
    for k in range(stages.dx.shape[0]):
        f = stage_force(stages, k, y[k], y[k + 1])
        if f >= 0.0:
            total += stages.dx[k] * stages.traction_cost * f
        elif stages.regeneration_gain > 0.0:
            most = stages.regeneration.force
            if stages.regeneration.kind != NO_LIMIT:
                most = min(most, speed_effort(stages.regeneration, np.sqrt(2.0 * y[k]))[0])
                most = min(most, speed_effort(stages.regeneration, np.sqrt(2.0 * y[k + 1]))[0])
            total -= stages.dx[k] * stages.regeneration_gain * min(-f, most)
    return total


@njit(cache=True)
def sweep(stages: Stages) -> tuple[Floats, int, int]:
    """Y = v^2/2 of the fastest profile, a fault and its node, or OK and 0."""
    n = stages.dx.shape[0]
    y = stages.top.copy()
    if stages.start == 0.0:
        y[0] = 0.0
    y[n] = min(float(y[n]), stages.end)
    for k in range(n - 1, -1, -1):
        if _may_brake(stages, k, y[k], y[k + 1]):
            continue
        low, high = min(y[k + 1], y[k]), y[k]
        guess = y[k + 1] + stages.decelerate * stages.dx[k]
        if guess < high and _may_brake(stages, k, guess, y[k + 1]):
            low = guess
            high = min(high, guess * (1.0 + 1e-12) + 1e-12)
        if not _may_brake(stages, k, low, y[k + 1]):
            low = 0.0  # even at steady speed the brakes cannot hold: enter slower
        y[k] = _last_true_brake(stages, k, low, high, y[k + 1])
        if k > 0 and y[k] <= SLOWEST:
            return y, CANNOT_BRAKE, k
    if y[0] < stages.start * (1.0 - 1e-9):
        return y, CANNOT_START, 0
    y[0] = stages.start
    for k in range(n):
        if _may_drive(stages, k, y[k], y[k + 1]):
            continue
        low, high = 0.0, y[k + 1]
        guess = y[k] + stages.accelerate * stages.dx[k]
        if guess < high and _may_drive(stages, k, y[k], guess):
            low = guess
            high = min(high, guess * (1.0 + 1e-12) + 1e-12)
        for _ in range(60):
            if high - low <= 1e-13 * high:
                break
            middle = 0.5 * (low + high)
            if _may_drive(stages, k, y[k], middle):
                low = middle
            else:
                high = middle
        if k < n - 1 and low <= SLOWEST:
            return y, CANNOT_CLIMB, k
        if k == n - 1 and low < stages.end * (1.0 - 1e-9) - 1e-9:
            y[n] = low
            return y, CANNOT_REACH, n
        y[k + 1] = low
    y[n] = stages.end
    return y, OK, 0


@njit(cache=True)
def _last_true_brake(stages: Stages, k: int, low: float, high: float, y1: float) -> float:
    for _ in range(60):
        if high - low <= 1e-13 * high:
            break
        middle = 0.5 * (low + high)
        if _may_brake(stages, k, middle, y1):
            low = middle
        else:
            high = middle
    return low


@njit(cache=True)
def _may_drive(stages: Stages, k: int, y0: float, y1: float) -> bool:
    """Whether acceleration and traction reach from y0 to y1 in stage k."""
    if (y1 - y0) > stages.accelerate * stages.dx[k] * (1.0 + 1e-12):
        return False
    f = stage_force(stages, k, y0, y1)
    if f > stages.traction.force:
        return False
    if stages.traction.kind == NO_LIMIT or f <= 0.0:
        return True
    return (
        f <= speed_effort(stages.traction, np.sqrt(2.0 * y0))[0]
        and f <= speed_effort(stages.traction, np.sqrt(2.0 * y1))[0]
    )


@njit(cache=True)
def _may_brake(stages: Stages, k: int, y0: float, y1: float) -> bool:
    """Whether deceleration and brakes reach from y0 to y1 in stage k."""
    if (y0 - y1) > stages.decelerate * stages.dx[k] * (1.0 + 1e-12):
        return False
    f = -stage_force(stages, k, y0, y1)
    if f > stages.brake:
        return False
    if stages.friction or f <= 0.0:
        return True
    if f > stages.regeneration.force:
        return False
    if stages.regeneration.kind == NO_LIMIT:
        return True
    return (
        f <= speed_effort(stages.regeneration, np.sqrt(2.0 * y0))[0]
        and f <= speed_effort(stages.regeneration, np.sqrt(2.0 * y1))[0]
    )
