"""Tubes around a profile that shrink: how a coarse grid finds a fine optimum where profiles may be mixed.

Of two profiles around the wanted time the mix in y = v^2/2 that takes exactly this time keeps every limit.
Around it the search is repeated in a narrower tube, with finer steps between the same number of states.
"""

from __future__ import annotations

import numpy as np

from controller.profile.dp_search import FIRST_MULTIPLIERS, TIME_TOLERANCE_S, Corridor, Search
from controller.profile.profile import Floats, ProfileError
from controller.profile.solution import Solution

GRID = 31
"""Speeds at each node; the tube makes up for the few."""
FIRST_GRID = 61
"""Speeds at each node in the first corridor, which is the widest."""
LOWER_EDGE = 0.25
"""Lower edge of the first corridor, in y of the fastest profile; lower for long trip times."""
DEEPENING = 0.1
LEAST_EDGE = 5e-4
TUBE = 0.2
TUBE_FLOOR = 0.5
"""Half width of the first tube: this share of y + 0.5 m^2/s^2."""
SHRINKING = 0.35
LEVELS = 4
WARM_LEVELS = 3
SPARE_LEVELS = 12
"""More of them, where the tube did not yet lie around the optimum."""
TOUCHING = 0.02
"""A tube is moved, not narrowed, if the profile touches its edges at more than this share of the nodes."""
BRACKET = 0.06
BRACKET_SHRINKING = 0.6
LEAST_BRACKET = 0.01
"""Relative half width of the multiplier's bracket around the last one, from level to level of the tube."""
PASSES = 4
TUBE_PASSES = 2


def in_tube(search: Search, start: Solution | None) -> tuple[Floats, float]:
    """Y = v^2/2 at the nodes and multiplier [W/kg] of a convex problem; ProfileError if none is found.

    `start` is only made use of if its tube holds the wanted optimum: one too far off would cost energy.
    """
    found = None
    if start is not None and len(start.speed_mps) == len(search.fast) and start.multiplier_w > 0.0:
        middle = np.minimum(0.5 * start.speed_mps**2, search.fast)
        guess = start.multiplier_w / search.problem.effective_mass_kg
        found = narrowed(search, middle, guess, WARM_LEVELS, may_miss=False)
    if found is None:
        found = narrowed(search, *_first_profile(search), LEVELS)
    if found is None:
        raise ProfileError(
            f"profile: dynamic programming found no profile of {search.problem.time_s:g} s; take the "
            "interior point or a finer mesh"
        )
    return found


def narrowed(
    search: Search, middle: Floats, guess: float, levels: int = LEVELS, *, may_miss: bool = True
) -> tuple[Floats, float] | None:
    """Profile and multiplier after the search in a tube around `middle`, narrower from level to level.

    None if the time is not met, or if the first tube does not hold the optimum and must (not `may_miss`).
    """
    width, reach, spare = TUBE, BRACKET, SPARE_LEVELS
    least, best = np.inf, None
    while levels > 0:
        half = width * (middle + TUBE_FLOOR)
        low = np.maximum(middle - half, LEAST_EDGE * middle)
        corridor = search.corridor(low, np.minimum(middle + half, search.fast), GRID)
        slow, quick = search.bracket(
            corridor, guess * (1.0 - reach), guess * (1.0 + reach), passes=TUBE_PASSES
        )
        missed = slow.is_edge or quick.is_edge
        if missed and not may_miss:
            return None
        may_miss = True
        middle, guess = search.mix(slow, quick)
        reach = max(LEAST_BRACKET, BRACKET_SHRINKING * reach)
        energy = search.energy(middle)
        falling = search.is_less(energy, least)
        if energy < least and abs(search.time_s(middle) - search.problem.time_s) < TIME_TOLERANCE_S:
            least, best = energy, (middle, guess)
        if spare > 0 and missed:
            width /= SHRINKING
            spare -= 1
        elif spare > 0 and (_touches(search, corridor, middle) or (levels == 1 and falling)):
            spare -= 1
        else:
            width *= SHRINKING
            levels -= 1
    return best


def lower_edge(search: Search) -> float:
    """How low the first corridor begins, as a share of the fastest profile's y."""
    return LOWER_EDGE * min(1.0, search.least_s / search.problem.time_s) ** 4


def _first_profile(search: Search) -> tuple[Floats, float]:
    """A rough optimum over the whole corridor, which is deepened until the profile keeps off its edge."""
    edge = lower_edge(search)
    while True:
        corridor = search.corridor(edge * search.fast, search.fast, FIRST_GRID)
        slow, quick = search.bracket(corridor, *FIRST_MULTIPLIERS, passes=PASSES)
        middle, guess = search.mix(slow, quick)
        if edge <= LEAST_EDGE or not np.any(middle[1:-1] < 1.1 * corridor.low[1:-1]):
            return middle, guess
        edge *= DEEPENING


def _touches(search: Search, corridor: Corridor, y: Floats) -> bool:
    """Whether a profile lies against the corridor's edges, where these are not the limits themselves."""
    margin = 0.02 * (corridor.high - corridor.low)
    low = y < corridor.low + margin
    high = (y > corridor.high - margin) & (corridor.high < search.fast)
    return bool(np.mean((low | high)[1:-1]) > TOUCHING)
