"""ODO, the odometer and balise reader: what the train believes about its own motion.

A wheel of slightly wrong diameter measures speed and distance with the same relative error; a slipping
or sliding wheel adds creep. Position is dead reckoning from balise to balise. Quantisation is the bus
contract's: what is sent is rounded there.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np

from hil.railway import Balise
from plant_sim.config import OdometryTable

STANDSTILL_MPS = 0.01
"""A wheel slower than this gives no pulse while the unit looks, and counts as standing."""

CREEP = 0.1
"""Relative speed of a slipping or sliding wheel against the train."""

CREEP_TIME_CONSTANT_S = 0.3
"""How fast a wheel starts to creep, and recovers."""


class Odometry:
    """Measures a true motion, cycle by cycle.

    Deterministic for a seed. `position_m` and `speed_mps` are the measured values; `passed` holds
    the balises read in the last cycle. The antenna is at the front of the train.
    """

    def __init__(self, table: OdometryTable, balises: Sequence[Balise], position_m: float, seed: int) -> None:
        self._table = table
        self._balises = tuple(sorted(balises, key=lambda balise: balise.position_m))
        self._places = [balise.position_m for balise in self._balises]
        self._random = np.random.default_rng(seed)
        self._true_m = position_m
        self._creep = 0.0
        self.position_m = position_m
        self.speed_mps = 0.0
        self.standstill = True
        self.slip = False
        self.slide = False
        self.passed: tuple[Balise, ...] = ()

    @property
    def error_m(self) -> float:
        """Measured minus true position."""
        return self.position_m - self._true_m

    def update(
        self, position_m: float, speed_mps: float, period_s: float, *, slips: bool, slides: bool
    ) -> None:
        """Measure the true position and speed after a cycle of `period_s`."""
        self.slip, self.slide = slips, slides
        wheel = self._wheel(period_s)
        self.speed_mps = speed_mps * wheel
        self.standstill = abs(self.speed_mps) < STANDSTILL_MPS
        if self._table.speed_noise_mps > 0.0 and not self.standstill:
            self.speed_mps += self._table.speed_noise_mps * self._random.standard_normal()
        before_m, self._true_m = self._true_m, position_m
        self.position_m += (position_m - before_m) * wheel
        self.passed = self._passed(before_m, position_m)
        if self.passed:
            last_m = self.passed[-1].position_m
            error_m = self._table.balise_error_m * self._random.standard_normal()
            self.position_m = last_m + error_m + (position_m - last_m) * wheel

    def _wheel(self, period_s: float) -> float:
        """Measured over true distance."""
        target = CREEP * (self.slip - self.slide)
        if target != 0.0 or self._creep != 0.0:
            self._creep += (target - self._creep) * min(1.0, period_s / CREEP_TIME_CONSTANT_S)
            if target == 0.0 and abs(self._creep) < 1e-6:
                self._creep = 0.0
        return (1.0 + self._table.wheel_diameter_error) * (1.0 + self._creep)

    def _passed(self, before_m: float, after_m: float) -> tuple[Balise, ...]:
        if after_m > before_m:
            low, high, step = bisect_right(self._places, before_m), bisect_right(self._places, after_m), 1
        else:
            low, high, step = bisect_left(self._places, after_m), bisect_left(self._places, before_m), -1
        if low == high:
            return ()
        there = self._balises[low:high][::step]
        missed = self._table.missed_balise_probability
        return tuple(balise for balise in there if self._random.random() >= missed)
