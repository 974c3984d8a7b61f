"""Solving a speed-profile problem: which solver, the fastest profile, the energy-time trade-off."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from controller.profile.interior_point import NotConverged, solve_ip
from controller.profile.problem import Problem
from controller.profile.profile import ProfileError
from controller.profile.solution import Solution
from controller.profile.sweep import fastest_profile

Solver = Literal["ip", "dp", "auto"]


def solve(problem: Problem, solver: Solver = "auto", *, start: Solution | None = None) -> Solution:
    """The profile of least energy that takes `problem.time_s`.

    "ip" is the interior point, "dp" dynamic programming; "auto" takes the interior point where the problem
    is convex, and dynamic programming where it is not or the interior point does not converge. `start` is a
    solution of a similar problem, to begin from. Raises Infeasible.
    """
    if problem.drive is not None and solver == "ip":
        raise ProfileError(
            "profile: notches, efficiency maps and neutral sections are not convex; solver must be dp or auto"
        )
    if solver != "dp" and problem.drive is None:
        try:
            return solve_ip(problem, start=start)
        except NotConverged:
            if solver == "ip":
                raise
    from controller.profile.dp import solve_dp  # compiled code that a good problem never needs

    return solve_dp(problem, start=start)


def fastest(problem: Problem) -> Solution:
    """The profile of least time within all limits; Infeasible if it cannot climb, brake or get away."""
    return fastest_profile(problem)


def energy_time_curve(problem: Problem, times: Iterable[float]) -> list[Solution]:
    """Solutions for several trip times [s], each started from the one before. Raises Infeasible."""
    solutions: list[Solution] = []
    for time_s in times:
        solutions.append(solve(problem.with_time(time_s), start=solutions[-1] if solutions else None))
    return solutions
