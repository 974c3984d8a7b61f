"""Where the problem is not convex: notches, efficiency maps, neutral sections (see `drive_map`).

One fine grid finds profiles around the wanted time. Without notches every mix of them is a profile too, and
the tube makes the best of it. With notches nothing may be mixed: profiles of other times are those that
change from one trial's policy to another's at a node, or that take another notch for one stage. What is
left of the time a brake takes up after the last traction, for a brake has no notches. Of the many the
cheapest within the tolerance is taken; if none is within, the nearest, and its time says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations

import numpy as np
from numba import njit

from controller.profile.dp_kernel import lowest_next, most_controls, next_under
from controller.profile.dp_search import (
    COARSE_MAPPED,
    FIRST_MULTIPLIERS,
    MAX_MULTIPLIER,
    Corridor,
    Search,
    Trial,
)
from controller.profile.dp_tube import LEAST_EDGE, lower_edge, narrowed
from controller.profile.drive_map import DriveArrays
from controller.profile.problem import Infeasible
from controller.profile.profile import Floats
from controller.profile.stages import Stages, stage_force

GRID = 161
"""Speeds at each node; the tube makes up for the few."""
NOTCH_GRID = 321
"""The same where no tube follows."""
FEWEST_STATES = 61
MOST_CONTROLS = 8_000_000
"""Of all stages together, 28 bytes each; a long line with many notches has fewer speeds at each node."""
PASSES = 24
TRIALS = 4
NODES = 64
MOST_JOINTS = 1500
"""How many trials, nodes and profiles in all are tried for a change from one policy to another."""
TIME_TOLERANCE_S = 0.01
DELAYED = 32
"""How many of the cheapest early profiles are delayed."""
HALVINGS = 40
TRACTION_N_PER_KG = 1e-6
"""Above rounding: a notch is a thousand times as much."""


def joined(search: Search) -> tuple[Floats, float]:
    """Y = v^2/2 at the nodes and multiplier [W/kg]; Infeasible where the drive does not keep the time."""
    wanted = search.problem.time_s
    corridor = search.corridor(max(lower_edge(search), LEAST_EDGE) * search.fast, search.fast, _grid(search))
    quickest = search.trial(corridor, MAX_MULTIPLIER)
    if quickest is None:
        raise Infeasible(
            "profile: the notches or neutral sections let the train not arrive at all",
            min_time_s=float("inf"),
            binding="drive",
        )
    search.least_s = max(search.least_s, quickest.time_s)
    if wanted < quickest.time_s - TIME_TOLERANCE_S:
        raise Infeasible(
            f"profile: {wanted:g} s must be at least {np.ceil(quickest.time_s * 100.0) / 100.0:.2f} s, "
            "the least time with these notches and neutral sections",
            min_time_s=quickest.time_s,
            binding="drive",
        )
    slow, quick = search.bracket(corridor, *FIRST_MULTIPLIERS, passes=PASSES)
    if len(search.drive.notches) == 0:
        found = narrowed(search, *search.mix(slow, quick))
        if found is not None:
            return found
    return _best_joint(search, corridor)


def _grid(search: Search) -> int:
    notches = len(search.drive.notches)
    affordable = MOST_CONTROLS // (len(search.fast) * most_controls(search.drive, COARSE_MAPPED))
    return max(FEWEST_STATES, min(NOTCH_GRID if notches else GRID, affordable))


def _best_joint(search: Search, corridor: Corridor) -> tuple[Floats, float]:
    """The cheapest profile within the tolerance of the time, or the nearest to it."""
    wanted = search.problem.time_s
    trials = sorted(search.trials, key=lambda t: abs(t.time_s - wanted))[:TRIALS]
    found = [t.y for t in trials] + list(_joints(search, corridor, trials))
    early = [y for y in found if search.time_s(y) <= wanted + TIME_TOLERANCE_S]
    early.sort(key=search.energy)
    best, least = found[0], (np.inf, np.inf)
    for y in [_delayed(search, y) for y in early[:DELAYED]] + found:
        miss = abs(search.time_s(y) - wanted)
        rank = (miss, 0.0) if miss > TIME_TOLERANCE_S else (0.0, search.energy(y))
        if rank < least:
            best, least = y, rank
    return best, trials[0].multiplier


def _delayed(search: Search, y: Floats) -> Floats:
    """The same profile, but later, by braking once more after the last traction: that costs no traction."""
    wanted = search.problem.time_s
    if search.time_s(y) >= wanted:
        return y
    low, high, best = 0.0, 1.0, y
    for _ in range(HALVINGS):
        share = 0.5 * (low + high)
        later = rolled(search.stages, search.drive, y, share)
        if search.time_s(later) <= wanted:
            low, best = share, later
        else:
            high = share
    return best


def _joints(search: Search, corridor: Corridor, trials: list[Trial]) -> Iterator[Floats]:
    n = len(search.fast)
    # the controls are numbered with those at the corners of an efficiency map first
    numbers = most_controls(search.drive, 0)
    pairs = list(permutations(trials, 2))
    nodes = range(0, n - 1, max(1, n // NODES, n * (len(pairs) + 2 * numbers) // MOST_JOINTS))
    for node in nodes:
        for early, late in pairs:
            y = search.follow(corridor, early, late, node)
            if y is not None:
                yield y
        for trial in trials[:2]:
            for forced in range(numbers):
                y = search.follow(corridor, trial, trial, node, forced)
                if y is not None:
                    yield y


@njit(cache=True, error_model="numpy")
def rolled(stages: Stages, drive: DriveArrays, y: Floats, share: float) -> Floats:
    """`y` with this share of it taken out by the brake after the last traction, then coasting back to it.

    Where the train would come to rest before the end the trip time is without bound.
    """
    n = stages.dx.shape[0]
    last = n - 1
    while last >= 0 and stage_force(stages, last, y[last], y[last + 1]) <= TRACTION_N_PER_KG:
        last -= 1
    first = last + 1
    while first < n and drive.neutral[first] and not stages.friction:
        first += 1  # no brake here
    later = y.copy()
    for k in range(first, n - 1):
        v = np.sqrt(2.0 * later[k])
        if k == first:
            aim = max((1.0 - share) * y[k + 1], lowest_next(stages, k, later[k], v))
        else:
            aim = next_under(stages, k, later[k], v, 0.0)
        later[k + 1] = min(y[k + 1], aim)
    return later
