"""Dynamic programming over position and speed, with the acceleration as the control (DP paper, section 3).

The trip time is met by a multiplier: minimised is energy + multiplier times time, and the multiplier is
searched for (:mod:`controller.profile.dp_search`). Where the problem is convex, the search is repeated in a
shrinking tube (:mod:`controller.profile.dp_tube`); where it is not (:mod:`controller.profile.drive_map`),
see :mod:`controller.profile.dp_joint`.
"""

from __future__ import annotations

import time

import numpy as np

from controller.profile.dp_joint import joined
from controller.profile.dp_search import Search
from controller.profile.dp_tube import in_tube
from controller.profile.problem import Problem
from controller.profile.solution import Solution
from controller.profile.sweep import too_short

AT_LEAST_TIME_S = 1e-3
"""A trip time this near to the least one is given the fastest profile."""


def solve_dp(problem: Problem, *, start: Solution | None = None) -> Solution:
    """The profile of least energy that takes `problem.time_s`.

    `start` is a solution of a similar problem on the same mesh, to begin from; it changes how long the search
    takes, not what it finds. With notches the time is met within 0.01 s where the notches allow it, else as
    nearly as found: see `trip_time_s`. Raises Infeasible where the time is too short, or where a neutral
    section or the notches stop the train.
    """
    began = time.perf_counter()
    search = Search(problem)
    least = search.least_s
    if problem.time_s < least - AT_LEAST_TIME_S:
        raise too_short(problem, search.stages, least)
    if problem.drive is not None:
        y, multiplier = joined(search)
    elif problem.time_s < least + AT_LEAST_TIME_S:
        y, multiplier = search.fast, 0.0
    else:
        y, multiplier = in_tube(search, start)
    return Solution.of_speeds(
        problem,
        np.sqrt(2.0 * y),
        solver="dp",
        min_time_s=search.least_s,
        solve_time_s=time.perf_counter() - began,
        iterations=search.passes,
        multiplier_w=multiplier * problem.effective_mass_kg,
    )
