"""Dynamic programming over position and speed, with the acceleration as the control (DP paper, section 3).

The trip time is met by a multiplier: minimised is energy + multiplier times time, and the multiplier is
searched for. Where the problem is convex, the two profiles around the wanted time are mixed in y = v^2/2,
which keeps every limit and meets the time exactly, and the search is repeated in a tube around the mix that
shrinks, so a coarse grid becomes a fine one. Where it is not (see :mod:`controller.profile.drive_map`), one
fine grid serves; with notches, which allow no mix, the policies of two multipliers are joined at the node
that comes nearest to the time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from controller.profile.dp_kernel import Controls, backward, controls_of, forward, profile_energy
from controller.profile.drive_map import DriveArrays, DriveMap
from controller.profile.problem import Infeasible, Problem
from controller.profile.profile import Floats, ProfileError
from controller.profile.solution import Solution
from controller.profile.stages import Stages, stages_of
from controller.profile.sweep import fastest_y, too_short, trip_time_s

GRID = 31
"""Speeds at each node where the problem is convex; the tube makes up for the few."""
FINE_GRID = 161
"""Speeds at each node where it is not."""
FINE = 16
"""Controls of the forward pass between the lowest and the highest."""
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
FALLING = 1e-4
"""Nor is the last tube the last one, if the energy still fell by more than this share."""
TOUCHING = 0.02
"""A tube is moved, not narrowed, if the profile touches its edges at more than this share of the nodes."""
FIRST_MULTIPLIERS = (5.0, 12.0)
"""Multipliers to begin with [W/kg]."""
BRACKET = 0.06
BRACKET_SHRINKING = 0.6
LEAST_BRACKET = 0.01
"""Relative half width of the multiplier's bracket around the last one, from level to level of the tube."""
LOWERINGS = 16
"""Halvings of the speed range in the search for a lower ceiling."""
MAX_MULTIPLIER = 1e5
MIN_MULTIPLIER = 1e-4
WIDE = 1.5
"""Where the multipliers of a bracket are this far apart, it takes as many passes as needed."""
MOST_PASSES = 12
PASSES = 4
TUBE_PASSES = 2
JOINT_PASSES = 24
JOINT_TRIALS = 5
JOINT_NODES = 64
"""How many trials and nodes are tried for a change from one policy to another."""
AT_LEAST_TIME_S = 1e-3
TIME_TOLERANCE_S = 1e-4
JOINT_TOLERANCE_S = 0.01
NO_DRIVE_MAP = DriveMap()


def solve_dp(problem: Problem, *, start: Solution | None = None) -> Solution:
    """The profile of least energy that takes `problem.time_s`.

    `start` is a solution of a similar problem on the same mesh, to begin from. Raises Infeasible where the
    time is too short, or where a neutral section or the notches stop the train.
    """
    began = time.perf_counter()
    stages = stages_of(problem)
    fast = fastest_y(problem, stages)
    least = trip_time_s(stages.dx, fast)
    if problem.time_s < least - AT_LEAST_TIME_S:
        raise too_short(problem, stages, least)
    drive = (problem.drive or NO_DRIVE_MAP).arrays(problem.position_m, problem.effective_mass_kg)
    search = _Search(problem, stages, drive, fast, least)
    if problem.drive is not None:
        y, multiplier = search.joined()
    elif problem.time_s < least + AT_LEAST_TIME_S:
        y, multiplier = fast, 0.0
    else:
        y, multiplier = search.in_tube(start)
    return Solution.of_speeds(
        problem,
        np.sqrt(2.0 * y),
        solver="dp",
        min_time_s=search.least_s,
        solve_time_s=time.perf_counter() - began,
        iterations=search.passes,
        multiplier_w=multiplier * problem.effective_mass_kg,
    )


@dataclass(frozen=True)
class _Trial:
    """One backward and forward pass: the multiplier, its values, the profile and its trip time."""

    multiplier: float
    value: Floats
    y: Floats
    time_s: float
    is_edge: bool = False
    """No profile of a multiplier, but the corridor's edge: the corridor does not hold the optimum."""


@dataclass(frozen=True)
class _Corridor:
    """Lower and upper edge of the states at every node, and all that may be done there."""

    low: Floats
    high: Floats
    points: int
    controls: Controls


class _Search:
    """The search for the multiplier, over one corridor after another."""

    def __init__(
        self, problem: Problem, stages: Stages, drive: DriveArrays, fast: Floats, least_s: float
    ) -> None:
        self._problem, self._stages, self._drive, self._fast = problem, stages, drive, fast
        self.least_s = least_s
        self.passes = 0
        self._scale = float(np.max(fast))
        self._trials: list[_Trial] = []

    def in_tube(self, start: Solution | None) -> tuple[Floats, float]:
        """Profile and multiplier of a convex problem."""
        if start is not None and len(start.speed_mps) == len(self._fast) and start.multiplier_w > 0.0:
            middle = np.minimum(0.5 * start.speed_mps**2, self._fast)
            guess = start.multiplier_w / self._problem.effective_mass_kg
            near = self._narrowed(middle, guess, WARM_LEVELS, may_miss=False)
            if near is not None:
                return near
        return self._cold()

    def _cold(self) -> tuple[Floats, float]:
        found = self._narrowed(*self._first_profile(), LEVELS)
        if found is None:
            raise ProfileError(
                f"profile: dynamic programming found no profile of {self._problem.time_s:g} s; take the "
                "interior point or a finer mesh"
            )
        return found

    def _narrowed(
        self, middle: Floats, guess: float, levels: int, *, may_miss: bool = True
    ) -> tuple[Floats, float] | None:
        """Profile and multiplier after the search in a tube around `middle`, narrower from level to level.

        None if the time is not met, or if the first tube does not hold the optimum and must (`may_miss`).
        """
        wanted = self._problem.time_s
        width, reach, spare = TUBE, BRACKET, SPARE_LEVELS
        least, best = np.inf, (middle, guess)
        while levels > 0:
            half = width * (middle + TUBE_FLOOR)
            low = np.maximum(middle - half, LEAST_EDGE * middle)
            corridor = self._corridor(low, np.minimum(middle + half, self._fast), GRID)
            slow, quick = self._bracket(
                corridor, guess * (1.0 - reach), guess * (1.0 + reach), passes=TUBE_PASSES
            )
            missed = slow.is_edge or quick.is_edge
            if missed and not may_miss:
                return None
            may_miss = True
            middle, guess = self._mix(slow, quick)
            reach = max(LEAST_BRACKET, BRACKET_SHRINKING * reach)
            energy = profile_energy(self._stages, self._drive, middle)
            falling = least - energy > FALLING * max(abs(energy), self._scale)
            if energy < least and abs(trip_time_s(self._stages.dx, middle) - wanted) < TIME_TOLERANCE_S:
                least, best = energy, (middle, guess)
            if spare > 0 and missed:
                width /= SHRINKING
                spare -= 1
            elif spare > 0 and (self._touches(corridor, middle) or (levels == 1 and falling)):
                spare -= 1
            else:
                width *= SHRINKING
                levels -= 1
        return best if least < np.inf else None

    def _first_profile(self) -> tuple[Floats, float]:
        """A rough optimum over the whole corridor, which is deepened until the profile keeps off its edge."""
        edge = LOWER_EDGE * min(1.0, self.least_s / self._problem.time_s) ** 4
        while True:
            corridor = self._corridor(edge * self._fast, self._fast, FIRST_GRID)
            slow, quick = self._bracket(corridor, *FIRST_MULTIPLIERS, passes=PASSES)
            middle, guess = self._mix(slow, quick)
            inner = slice(1, -1)
            if edge <= LEAST_EDGE or not np.any(middle[inner] < 1.1 * corridor.low[inner]):
                return middle, guess
            edge *= DEEPENING

    def _touches(self, corridor: _Corridor, y: Floats) -> bool:
        """Whether a profile lies against the corridor's edges, where these are not the limits themselves."""
        margin = 0.02 * (corridor.high - corridor.low)
        low = y < corridor.low + margin
        high = (y > corridor.high - margin) & (corridor.high < self._fast)
        return bool(np.mean((low | high)[1:-1]) > TOUCHING)

    def joined(self) -> tuple[Floats, float]:
        """Profile and multiplier of a problem that is not convex; its time is met as nearly as can be."""
        wanted = self._problem.time_s
        edge = LOWER_EDGE * min(1.0, self.least_s / wanted) ** 4
        corridor = self._corridor(max(edge, LEAST_EDGE) * self._fast, self._fast, FINE_GRID)
        quickest = self._trial(corridor, MAX_MULTIPLIER)
        if quickest is None:
            raise Infeasible(
                "profile: the notches or neutral sections let the train not arrive at all",
                min_time_s=float("inf"),
                binding="drive",
            )
        self.least_s = max(self.least_s, quickest.time_s)
        if wanted < quickest.time_s - JOINT_TOLERANCE_S:
            raise Infeasible(
                f"profile: {wanted:g} s must be at least {np.ceil(quickest.time_s * 100.0) / 100.0:.2f} s, "
                "the least time with these notches and neutral sections",
                min_time_s=quickest.time_s,
                binding="drive",
            )
        slow, quick = self._bracket(corridor, *FIRST_MULTIPLIERS, passes=JOINT_PASSES)
        if len(self._drive.notches) == 0:
            # Every mix of two profiles keeps the neutral sections too.
            found = self._narrowed(*self._mix(slow, quick), LEVELS)
            if found is not None:
                return found
        return self._best_joint(corridor)

    def _best_joint(self, corridor: _Corridor) -> tuple[Floats, float]:
        """The profile nearest to the time of those that change from one trial's policy to another's.

        Between two notches there is nothing, so a mix would need efforts that the drive does not have.
        """
        wanted = self._problem.time_s
        trials = sorted(self._trials, key=lambda t: abs(t.time_s - wanted))[:JOINT_TRIALS]
        best, miss = trials[0], abs(trials[0].time_s - wanted)
        y, n = best.y, len(self._fast)
        for early, late in permutations(trials, 2):
            for node in range(1, n - 1, max(1, n // JOINT_NODES)):
                if miss <= TIME_TOLERANCE_S:
                    break
                joint = np.empty_like(y)
                whole = forward(
                    self._stages, self._drive, corridor.low, corridor.high, early.multiplier,
                    late.multiplier, early.value, late.value, node, -1, FINE, joint,
                )  # fmt: skip
                off = abs(trip_time_s(self._stages.dx, joint) - wanted) if whole else np.inf
                if off < miss:
                    y, miss = joint, off
        return y, best.multiplier

    def _corridor(self, low: Floats, high: Floats, points: int) -> _Corridor:
        low, high = low.copy(), high.copy()
        low[0] = high[0] = self._stages.start
        low[-1] = high[-1] = self._stages.end
        low = np.minimum(low, high)
        return _Corridor(low, high, points, controls_of(self._stages, self._drive, low, high, points, 7))

    def _trial(self, corridor: _Corridor, multiplier: float) -> _Trial | None:
        """Profile of one multiplier; None if every way is blocked."""
        self.passes += 1
        n = len(self._fast)
        value, y = np.empty((n, corridor.points)), np.empty(n)
        backward(corridor.controls, multiplier, value)
        whole = forward(
            self._stages, self._drive, corridor.low, corridor.high, multiplier, multiplier, value, value, n,
            -1, FINE, y,
        )  # fmt: skip
        if not whole:
            return None
        trial = _Trial(multiplier, value, y, trip_time_s(self._stages.dx, y))
        if self._problem.drive is not None:
            self._trials.append(trial)
        return trial

    def _bracket(self, corridor: _Corridor, low: float, high: float, *, passes: int) -> tuple[_Trial, _Trial]:
        """Two trials, one at least as slow as wanted and one at least as quick, near to each other."""
        wanted = self._problem.time_s
        slow = self._first(corridor, low, lambda t: t.time_s >= wanted, 0.3)
        quick = self._first(corridor, high, lambda t: t.time_s <= wanted, 3.0)
        used = 0
        while slow.time_s - quick.time_s > TIME_TOLERANCE_S and slow.multiplier < quick.multiplier:
            if used >= (passes if quick.multiplier < WIDE * slow.multiplier else MOST_PASSES):
                break
            # Over orders of magnitude the time goes with a power of the multiplier.
            share = np.log(slow.time_s / wanted) / np.log(slow.time_s / quick.time_s)
            share = min(max(float(share), 0.1), 0.9)
            logs = np.log(slow.multiplier), np.log(quick.multiplier)
            middle = self._trial(corridor, float(np.exp(logs[0] + share * (logs[1] - logs[0]))))
            used += 1
            if middle is None:
                break
            if middle.time_s >= wanted:
                slow = middle
            else:
                quick = middle
            if abs(logs[1] - logs[0]) < 1e-3:
                break
        return slow, quick

    def _first(
        self, corridor: _Corridor, multiplier: float, holds: Callable[[_Trial], bool], factor: float
    ) -> _Trial:
        """The first trial that is slow (or quick) enough, the multiplier going down (or up)."""
        nearest: _Trial | None = None
        while MIN_MULTIPLIER < multiplier < MAX_MULTIPLIER:
            trial = self._trial(corridor, multiplier)
            if trial is not None:
                nearest = trial
                if holds(trial):
                    return trial
            multiplier *= factor
            factor *= factor  # the further off, the longer the strides
        if factor < 1.0 and nearest is not None:
            lowered = self._lowered(corridor, nearest)
            if lowered is not None:
                return lowered
        edge = corridor.low if factor < 1.0 else corridor.high
        if factor < 1.0 or nearest is None or self._problem.drive is None:
            # No multiplier is slow (or quick) enough: the edge of the corridor is.
            return _Trial(
                multiplier, np.empty((0, 0)), edge, trip_time_s(self._stages.dx, edge), is_edge=True
            )
        return nearest

    def _lowered(self, corridor: _Corridor, quick: _Trial) -> _Trial | None:
        """A slow enough trial under a lower ceiling, if that costs nothing; None if it does.

        Where more time saves no energy, as on a descent, no multiplier makes the train slower.
        """
        wanted, slow = self._problem.time_s, None
        low, high = 0.0, float(np.max(quick.y))
        for _ in range(LOWERINGS):
            ceiling = 0.5 * (low + high)
            under = np.minimum(corridor.high, ceiling)
            trial = self._trial(self._corridor(corridor.low, under, corridor.points), quick.multiplier)
            if trial is None or trial.time_s > wanted:
                low, slow = ceiling, trial or slow
            else:
                high = ceiling
        if slow is None or slow.time_s < wanted:
            return None
        dearer = profile_energy(self._stages, self._drive, slow.y)
        dearer -= profile_energy(self._stages, self._drive, quick.y)
        return slow if dearer <= FALLING * self._scale else None

    def _mix(self, slow: _Trial, quick: _Trial) -> tuple[Floats, float]:
        """The mix of two profiles that takes the wanted time, and the multiplier between theirs."""
        dx, wanted = self._stages.dx, self._problem.time_s
        low, high = 0.0, 1.0
        if slow.time_s <= wanted:
            high = 0.0
        elif quick.time_s >= wanted:
            low = 1.0
        while high - low > 1e-12:
            share = 0.5 * (low + high)
            if trip_time_s(dx, (1.0 - share) * slow.y + share * quick.y) > wanted:
                low = share
            else:
                high = share
        share = 0.5 * (low + high)
        return (1.0 - share) * slow.y + share * quick.y, slow.multiplier ** (
            1.0 - share
        ) * quick.multiplier**share
