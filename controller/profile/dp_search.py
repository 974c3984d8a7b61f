"""One corridor of the dynamic programming: the profile of a multiplier, and two profiles around a time.

A corridor is a lower and an upper edge of y = v^2/2 at every node. In it energy plus multiplier times time
is least for one profile; a higher multiplier makes it quicker. The search closes in on the wanted time from
both sides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controller.profile.dp_kernel import Controls, backward, controls_of, forward, profile_energy
from controller.profile.drive_map import DriveArrays, DriveMap
from controller.profile.problem import Problem
from controller.profile.profile import Floats
from controller.profile.stages import stages_of
from controller.profile.sweep import fastest_y, trip_time_s

COARSE = 7
"""Controls of the backward pass between the lowest and the highest; interpolation does the rest."""
COARSE_MAPPED = 15
"""More of them where the cost of a stage has several hollows."""
FINE = 16
"""Controls of the forward pass between the lowest and the highest."""
FIRST_MULTIPLIERS = (5.0, 12.0)
"""Multipliers to begin with [W/kg]."""
MAX_MULTIPLIER = 1e5
MIN_MULTIPLIER = 1e-4
WIDE = 1.5
"""Where the multipliers of a bracket are this far apart, it takes as many passes as needed."""
MOST_PASSES = 12
LOWERINGS = 16
"""Halvings of the speed range in the search for a lower ceiling."""
TIME_TOLERANCE_S = 1e-4
FALLING = 1e-4
"""An energy that falls by less than this share has arrived."""
NO_DRIVE_MAP = DriveMap()


@dataclass(frozen=True)
class Trial:
    """One backward and forward pass: the multiplier, its values, the profile and its trip time."""

    multiplier: float
    value: Floats
    y: Floats
    time_s: float
    is_edge: bool = False
    """No profile of a multiplier, but the corridor's edge: the corridor does not hold the optimum."""


@dataclass(frozen=True)
class Corridor:
    """Lower and upper edge of the states at every node, and all that may be done there."""

    low: Floats
    high: Floats
    points: int
    controls: Controls


class Search:
    """What all corridors of one problem share, and the passes in them."""

    def __init__(self, problem: Problem) -> None:
        """Raises Infeasible if there is no profile at all."""
        self.problem = problem
        self.stages = stages_of(problem)
        self.fast = fastest_y(problem, self.stages)
        self.least_s = trip_time_s(self.stages.dx, self.fast)
        self.drive: DriveArrays = (problem.drive or NO_DRIVE_MAP).arrays(
            problem.position_m, problem.effective_mass_kg
        )
        self.passes = 0
        self.trials: list[Trial] = []
        """All of them where the problem is not convex, else none."""
        self._scale = float(np.max(self.fast))
        self._evenly = COARSE_MAPPED if self.drive.mapped else COARSE

    def time_s(self, y: Floats) -> float:
        """Trip time of a profile [s]."""
        return trip_time_s(self.stages.dx, y)

    def energy(self, y: Floats) -> float:
        """Energy at the line of a profile per mass [J/kg]."""
        return profile_energy(self.stages, self.drive, y)

    def is_less(self, energy: float, than: float) -> bool:
        """Whether an energy [J/kg] is less by more than the search is good for."""
        return than - energy > FALLING * max(abs(energy), self._scale)

    def corridor(self, low: Floats, high: Floats, points: int) -> Corridor:
        """Corridor with a grid of `points` at every node, and start and end speed as wanted."""
        low, high = low.copy(), high.copy()
        low[0] = high[0] = self.stages.start
        low[-1] = high[-1] = self.stages.end
        low = np.minimum(low, high)
        controls = controls_of(self.stages, self.drive, low, high, points, self._evenly)
        return Corridor(low, high, points, controls)

    def trial(self, corridor: Corridor, multiplier: float) -> Trial | None:
        """Profile of one multiplier; None if every way is blocked."""
        self.passes += 1
        value = np.empty((len(self.fast), corridor.points))
        backward(corridor.controls, multiplier, value)
        y = self.follow(corridor, Trial(multiplier, value, self.fast, 0.0))
        if y is None:
            return None
        trial = Trial(multiplier, value, y, self.time_s(y))
        if self.problem.drive is not None:
            self.trials.append(trial)
        return trial

    def follow(
        self, corridor: Corridor, early: Trial, late: Trial | None = None, node: int = -1, forced: int = -1
    ) -> Floats | None:
        """Profile of one trial's policy, or of another's from `node` on; None if it runs into a dead end.

        In the stage after the node control number `forced` is taken, if not negative.
        """
        y, late = np.empty_like(self.fast), late or early
        whole = forward(
            self.stages, self.drive, corridor.low, corridor.high, early.multiplier, late.multiplier,
            early.value, late.value, node, forced, FINE, y,
        )  # fmt: skip
        return y if whole else None

    def bracket(self, corridor: Corridor, low: float, high: float, *, passes: int) -> tuple[Trial, Trial]:
        """Two trials, one at least as slow as wanted and one at least as quick, near to each other."""
        wanted = self.problem.time_s
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
            middle = self.trial(corridor, float(np.exp(logs[0] + share * (logs[1] - logs[0]))))
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

    def mix(self, slow: Trial, quick: Trial) -> tuple[Floats, float]:
        """The mix of two profiles that takes the wanted time, and the multiplier between theirs."""
        wanted = self.problem.time_s
        low, high = 0.0, 1.0
        if slow.time_s <= wanted:
            high = 0.0
        elif quick.time_s >= wanted:
            low = 1.0
        while high - low > 1e-12:
            share = 0.5 * (low + high)
            if self.time_s((1.0 - share) * slow.y + share * quick.y) > wanted:
                low = share
            else:
                high = share
        share = 0.5 * (low + high)
        multiplier = slow.multiplier ** (1.0 - share) * quick.multiplier**share
        return (1.0 - share) * slow.y + share * quick.y, multiplier

    def _first(
        self, corridor: Corridor, multiplier: float, holds: Callable[[Trial], bool], factor: float
    ) -> Trial:
        """The first trial that is slow (or quick) enough, the multiplier going down (or up)."""
        slower = factor < 1.0
        nearest: Trial | None = None
        while MIN_MULTIPLIER < multiplier < MAX_MULTIPLIER:
            trial = self.trial(corridor, multiplier)
            if trial is not None:
                nearest = trial
                if holds(trial):
                    return trial
            multiplier *= factor
            factor *= factor  # the further off, the longer the strides
        if slower and nearest is not None:
            lowered = self._lowered(corridor, nearest)
            if lowered is not None:
                return lowered
        if nearest is not None and not slower and self.problem.drive is not None:
            return nearest
        # No multiplier is slow (or quick) enough: the edge of the corridor is.
        edge = corridor.low if slower else corridor.high
        return Trial(multiplier, np.empty((0, 0)), edge, self.time_s(edge), is_edge=True)

    def _lowered(self, corridor: Corridor, quick: Trial) -> Trial | None:
        """A slow enough trial under a lower ceiling, if that costs nothing; None if it does.

        Where more time saves no energy, as on a descent, no multiplier makes the train slower.
        """
        wanted = self.problem.time_s
        slow: Trial | None = None
        low, high = 0.0, float(np.max(quick.y))
        for _ in range(LOWERINGS):
            ceiling = 0.5 * (low + high)
            under = np.minimum(corridor.high, ceiling)
            trial = self.trial(self.corridor(corridor.low, under, corridor.points), quick.multiplier)
            if trial is None or trial.time_s > wanted:
                low, slow = ceiling, trial or slow
            else:
                high = ceiling
        if slow is None or self.is_less(self.energy(quick.y), self.energy(slow.y)):
            return None
        return slow
