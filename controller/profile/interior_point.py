"""The interior point: energy-optimal profiles in kinetic energy, where the problem is all but convex.

In y = v^2/2 the accelerations and limits are linear, the cost of a stage is the highest of a few linear
pieces and the trip time is convex. What is not convex is small (the Davis term in v) or is an effort over
speed, P/v, which is convex where it should be concave: its tangent at the present speed lies below it, so
each step keeps the limit. Train control as a convex problem in v^2: Lu, Feng and Wu, arXiv:2202.06303.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from controller.profile.interior_point_kernel import CONVERGED, Conditions, Start, interior_point
from controller.profile.problem import Problem
from controller.profile.profile import Floats, ProfileError
from controller.profile.solution import Solution
from controller.profile.stages import NO_LIMIT, Stages, stages_of
from controller.profile.sweep import OK, fastest_y, stage_cost, sweep, too_short, trip_time_s

TOLERANCE = 1e-6
"""Of the duality gap against the energy, and of every residual in its unit."""
MAX_ITERATIONS = 80
AT_LEAST_TIME_S = 1e-3
"""A trip time this near to the least one is given the fastest profile."""
CRAWL_Y = 0.02
CRAWL_SHARE = 0.02
"""A moving train has at least 0.2 m/s, or a small share of the highest y = v^2/2 that is possible there."""
TIME_TOLERANCE_S = 2e-3
"""A trip this much shorter than asked for is stretched."""
SLOWER_TRIALS = 16
TOLERATED_COST = 1e-4
"""What lower speed limits may cost, of the energy of the fastest profile."""
LADDER = (
    Start(barrier=1.0, least_centring=0.0, equal_steps=False, multiplier=2.0),
    Start(barrier=0.1, least_centring=0.0, equal_steps=False, multiplier=5.0),
    Start(barrier=10.0, least_centring=0.05, equal_steps=False, multiplier=20.0),
    Start(barrier=1.0, least_centring=0.3, equal_steps=True, multiplier=5.0),
    Start(barrier=0.01, least_centring=0.2, equal_steps=True, multiplier=1.0),
)
"""Starts, the next one where the one before did not converge; the first does on nearly all routes."""
WARM = Start(barrier=0.5, least_centring=0.0, equal_steps=False, multiplier=5.0)
WARM_SHARE = 0.98
"""A start from a known solution stays this far below the fastest profile."""


class NotConverged(ProfileError):
    """The interior point did not reach its tolerance from any of its starts."""


def conditions_of(stages: Stages) -> Conditions:
    """The conditions that this problem's stages have; see `Conditions`."""
    rows: list[tuple[float, float, float, float, float, float]] = []

    def add(*, cost: float = 0.0, force: float = 0.0, acceleration: float = 0.0, gain: float = 0.0,
            effort: int = 0, constant: float = 0.0) -> None:  # fmt: skip
        rows.append((cost, force, acceleration, gain, float(effort), constant))

    gain, braking, traction = stages.regeneration_gain, stages.regeneration, stages.traction
    add(cost=1.0, force=-stages.traction_cost)
    add(cost=1.0, force=-gain)
    limited = gain > 0.0 and stages.friction
    if limited and np.isfinite(braking.force):
        add(cost=1.0, constant=gain * braking.force)
    if limited and braking.kind != NO_LIMIT:
        add(cost=1.0, gain=gain, effort=3)
        add(cost=1.0, gain=gain, effort=4)
    costs = len(rows)
    add(acceleration=-1.0, constant=stages.accelerate)
    add(acceleration=1.0, constant=stages.decelerate)
    if np.isfinite(traction.force):
        add(force=-1.0, constant=traction.force)
    if traction.kind != NO_LIMIT:
        add(force=-1.0, gain=1.0, effort=1)
        add(force=-1.0, gain=1.0, effort=2)
    hold = min(stages.brake, np.inf if stages.friction else braking.force)
    if np.isfinite(hold):
        add(force=1.0, constant=hold)
    if not stages.friction and braking.kind != NO_LIMIT:
        add(force=1.0, gain=1.0, effort=3)
        add(force=1.0, gain=1.0, effort=4)
    table = np.array(rows)
    return Conditions(costs, *(np.ascontiguousarray(table[:, k]) for k in (1, 2, 3, 4, 5)))


def solve_ip(problem: Problem, *, start: Solution | None = None) -> Solution:
    """The profile of least energy; Infeasible below the least time, NotConverged if every start fails."""
    began = time.perf_counter()
    stages = stages_of(problem)
    fast = fastest_y(problem, stages)
    least = trip_time_s(stages.dx, fast)

    def solution(y: Floats, iterations: int, multiplier: float) -> Solution:
        return Solution.of_speeds(
            problem,
            np.sqrt(2.0 * y),
            solver="ip",
            min_time_s=least,
            solve_time_s=time.perf_counter() - began,
            iterations=iterations,
            multiplier_w=multiplier * problem.effective_mass_kg,
        )

    if problem.time_s < least - AT_LEAST_TIME_S:
        raise too_short(problem, stages, least)
    if problem.time_s < least + AT_LEAST_TIME_S:
        return solution(fast, 0, 0.0)
    optimum = _optimum(problem, stages, fast, least, start)
    if problem.time_s - trip_time_s(stages.dx, optimum.y) > TIME_TOLERANCE_S:
        optimum = _slower(problem, stages, fast, optimum)
    return solution(optimum.y, optimum.iterations, optimum.multiplier)


class _Optimum(NamedTuple):
    y: Floats
    iterations: int
    multiplier: float


def _optimum(
    problem: Problem, stages: Stages, fast: Floats, least: float, start: Solution | None = None
) -> _Optimum:
    """Least energy within the time; it may take less than that where more time saves nothing."""
    conditions = conditions_of(stages)
    begin = (least / problem.time_s) ** 2 * fast
    begin[0], begin[-1] = fast[0], fast[-1]
    floor = np.minimum(CRAWL_Y, CRAWL_SHARE * fast)
    begin[1:-1] = np.maximum(begin[1:-1], 2.0 * floor[1:-1])
    attempts = [(begin, attempt) for attempt in LADDER]
    if (
        start is not None
        and abs(start.problem.length_m - problem.length_m) < 1.0
        and start.multiplier_w > 0.0
    ):
        known = np.interp(problem.position_m, start.problem.position_m, 0.5 * start.speed_mps**2)
        known *= (start.trip_time_s / problem.time_s) ** 2
        near = np.clip(known, 2.0 * floor, WARM_SHARE * fast)
        near[0], near[-1] = fast[0], fast[-1]
        multiplier = start.multiplier_w / problem.effective_mass_kg
        attempts.insert(0, (near, WARM._replace(multiplier=multiplier)))
    total = 0
    error = np.inf
    for first, attempt in attempts:
        y, multiplier, state, iterations, error = interior_point(
            stages, conditions, float(problem.time_s), first, floor, attempt, MAX_ITERATIONS, TOLERANCE
        )
        total += iterations
        if state == CONVERGED:
            return _Optimum(y, total, multiplier)
    raise NotConverged(
        f"profile: the interior point stopped at an error of {error:.1e}, {TOLERANCE:g} wanted, after "
        f"{total} iterations; dynamic programming (solver dp) does not need to converge"
    )


def _slower(problem: Problem, stages: Stages, fast: Floats, quick: _Optimum) -> _Optimum:
    """A profile that takes its time although more time saves nothing.

    Lower speed limits, if they cost no energy to speak of (downhill all the way they do not); else the
    profile of least energy with a crawl at departure or arrival, which stands for standing longer.
    """
    least_energy = stage_cost(stages, quick.y)
    scale = TOLERATED_COST * max(stage_cost(stages._replace(regeneration_gain=0.0), fast), 1.0)
    found, iterations = _lowered_limits(problem, stages, quick, least_energy + scale)
    if found is None:
        ends = [_slow_end(problem.time_s, stages, quick.y, node) for node in (1, len(quick.y) - 2)]
        kept = [y for y in ends if problem.time_s - trip_time_s(stages.dx, y) <= TIME_TOLERANCE_S]
        if not kept:
            raise NotConverged(
                f"profile: {problem.time_s:g} s is more than the slowest run between two moving ends can take"
            )
        found = quick._replace(y=min(kept, key=lambda y: stage_cost(stages, y)))
    return found._replace(iterations=quick.iterations + iterations, multiplier=0.0)


def _lowered_limits(
    problem: Problem, stages: Stages, quick: _Optimum, most_energy: float
) -> tuple[_Optimum | None, int]:
    """The optimum under the highest share of all speed limits that takes its time, if it costs no more."""
    x = problem.position_m
    brakes = stages.start - 0.5 * stages.decelerate * x
    drives = stages.end - 0.5 * stages.accelerate * (x[-1] - x)
    low, high = 0.0, 1.0
    iterations = 0
    for _ in range(SLOWER_TRIALS):
        share = 0.5 * (low + high)
        lowered = np.minimum(stages.top, np.maximum(share * stages.top, np.maximum(brakes, drives)))
        capped = stages._replace(top=lowered)
        y, fault, _node = sweep(capped)
        least = trip_time_s(stages.dx, y) if fault == OK else np.inf
        if least >= problem.time_s:
            low = share
            continue
        try:
            trial = _optimum(problem, capped, y, least)
        except NotConverged:  # next to the least time under this limit
            low = share
            continue
        iterations += trial.iterations
        if stage_cost(stages, trial.y) > most_energy:
            low = share
        elif problem.time_s - trip_time_s(stages.dx, trial.y) <= TIME_TOLERANCE_S:
            return trial, iterations
        else:
            high = share
    return None, iterations


def _slow_end(time_s: float, stages: Stages, y: Floats, node: int) -> Floats:
    """The profile y with a node next to one of its ends so slow that the trip takes its time, if it can."""
    low, high = np.log(1e-12), np.log(max(y[node], 1e-12))
    best = y
    for _ in range(80):
        middle = 0.5 * (low + high)
        top = y.copy()
        top[node] = np.exp(middle)
        trial, fault, _node = sweep(stages._replace(top=top))
        if fault == OK and trip_time_s(stages.dx, trial) <= time_s:
            high, best = middle, trial
        else:
            low = middle
    return best
