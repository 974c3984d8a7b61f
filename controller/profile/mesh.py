"""The position mesh of a speed profile: a node on every boundary, and no step above a maximum."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from controller.profile.profile import Floats, ProfileError

DEFAULT_STEP_M = 5.0
"""Largest step of the mesh: with aligned boundaries a metro section is then within 0.02 % of its optimum."""
SHORTEST_STAGE_M = 1e-3
"""Boundaries nearer to each other than this are one node."""
MOST_STAGES = 1_000_000


def mesh(start_m: float, end_m: float, boundaries_m: Iterable[float], max_step_m: float) -> Floats:
    """Ascending nodes [m] from `start_m` to `end_m`, both exact, with a node on every boundary between.

    Between two boundaries the nodes are evenly spaced, at most `max_step_m` apart. Boundaries outside are
    ignored. Without a node on a boundary a limit or gradient would act on the wrong side of it: 0.5 % of the
    energy at ten metres. ProfileError if the end does not lie beyond the start, or the step is not positive
    or so small that there would be more than MOST_STAGES stages.
    """
    if not end_m > start_m:
        raise ProfileError(f"mesh: end {end_m:g} m must lie beyond start {start_m:g} m")
    if not max_step_m > 0.0:
        raise ProfileError(f"mesh: max_step_m: {max_step_m:g} must be greater than 0")
    if (end_m - start_m) / max_step_m > MOST_STAGES:
        least = (end_m - start_m) / MOST_STAGES
        raise ProfileError(f"mesh: max_step_m: {max_step_m:g} must be at least {least:g} on this distance")
    corners = [start_m]
    for place in sorted({float(place) for place in boundaries_m}):
        if corners[-1] + SHORTEST_STAGE_M < place < end_m - SHORTEST_STAGE_M:
            corners.append(place)
    corners.append(end_m)
    pieces = [
        # the small allowance keeps 931 m in steps of 9.31 m at 100 stages
        np.linspace(left, right, max(1, int(np.ceil((right - left) / max_step_m - 1e-9))), endpoint=False)
        for left, right in pairwise(corners)
    ]
    return np.concatenate([*pieces, np.array([end_m])])
