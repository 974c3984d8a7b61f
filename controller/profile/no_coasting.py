"""The plan without coasting: accelerate, cruise at one speed, brake. An optimum is measured by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from controller.profile.problem import Infeasible, Problem
from controller.profile.solution import Solution
from controller.profile.solve import fastest

TIME_TOLERANCE_S = 1e-6
SLOWEST_SHARE = 0.02
"""Lowest cruising speed that is tried, as a share of the highest limit."""


def accelerate_cruise_brake(problem: Problem) -> Solution:
    """The fastest profile under one cruising speed, chosen so that it takes `problem.time_s`.

    Where the line falls the train brakes to keep that speed. If even the lowest speed tried is too fast,
    its profile is returned. Raises Infeasible if the time is too short.
    """
    top = float(np.max(problem.speed_limit_mps))
    quickest = fastest(problem)
    low, high = SLOWEST_SHARE * top, float(np.max(quickest.speed_mps))
    if problem.time_s < quickest.trip_time_s - TIME_TOLERANCE_S:
        raise Infeasible(
            f"profile: {problem.time_s:g} s must be at least {quickest.trip_time_s:.2f} s, the least time",
            min_time_s=quickest.trip_time_s,
            binding="time",
        )
    best = quickest
    for _ in range(80):
        middle = 0.5 * (low + high)
        best = _capped(problem, middle)
        error = best.trip_time_s - problem.time_s
        if abs(error) < TIME_TOLERANCE_S:
            break
        low, high = (middle, high) if error > 0.0 else (low, middle)
    return Solution.of_speeds(problem, best.speed_mps, solver="no coasting", min_time_s=quickest.trip_time_s)


def _capped(problem: Problem, cruising_mps: float) -> Solution:
    return fastest(replace(problem, speed_limit_mps=np.minimum(problem.speed_limit_mps, cruising_mps)))
