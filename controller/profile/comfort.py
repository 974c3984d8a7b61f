"""What makes a sharp plan comfortable: its accelerations, and the two averages that bound jerk.

A sharp plan has steps in its acceleration. Averaged over `window_s` of time they become ramps of at most
`jerk`; averaged again over `smoothing_s`, the jerk itself sets in and ends as a ramp. Both averages look
back only, so where a comfortable plan is and how fast follows from the sharp plan up to that moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from controller.config import ProfileConfig
from controller.profile.profile import Floats, SpeedProfile
from hil.railway import Line, SpeedLimit, Train

ACCELERATION_SHARE = 0.85
BRAKING_SHARE = 0.62
"""Shares of the train's own limits that a plan takes where the scenario gives no figures."""
LIMIT_MARGIN_M = 2.0
"""Further widening of limits: the smoothed run is displaced by up to `b T^2 / 24` against the sharp one."""
LOWEST_LIMIT_MPS = 0.5


@dataclass(frozen=True)
class Comfort:
    """Accelerations of a plan (positive numbers), and the windows of its two averages."""

    acceleration_mps2: float
    braking_mps2: float
    window_s: float
    smoothing_s: float
    stop_braking_mps2: float
    stop_braking_s: float
    speed_margin_mps: float

    @classmethod
    def of(cls, train: Train, config: ProfileConfig) -> Self:
        """Figures of the scenario, or the train's where it gives none."""
        acceleration = config.acceleration_mps2 or ACCELERATION_SHARE * train.max_acceleration_mps2
        braking = config.braking_mps2 or BRAKING_SHARE * train.max_braking_mps2
        jerk = config.jerk_mps3 or train.comfort_jerk_mps3
        return cls(
            acceleration_mps2=acceleration,
            braking_mps2=braking,
            window_s=max(acceleration, braking) / jerk,
            smoothing_s=config.smoothing_s,
            stop_braking_mps2=min(config.stop_braking_mps2, braking),
            stop_braking_s=config.stop_braking_s,
            speed_margin_mps=config.speed_margin_mps,
        )

    @property
    def delay_s(self) -> float:
        """By how much both averages lengthen a run [s]."""
        return self.window_s + self.smoothing_s

    @property
    def largest_step_mps2(self) -> float:
        """Change of the sharp acceleration within one window that still keeps the jerk."""
        return max(self.acceleration_mps2, self.braking_mps2)

    @property
    def slow_mps(self) -> float:
        """Below this speed the sharp plan brakes to its stop with `stop_braking_mps2`."""
        return self.stop_braking_mps2 * (self.stop_braking_s + 0.5 * self.window_s)

    @property
    def tail_m(self) -> float:
        """Length of that last part [m]."""
        return 0.5 * self.slow_mps**2 / self.stop_braking_mps2

    def smoothed(self, sharp: SpeedProfile) -> SpeedProfile:
        """The comfortable plan."""
        plan = sharp.smoothed(self.window_s)
        return plan.smoothed(self.smoothing_s) if self.smoothing_s > 0.0 else plan

    def widened_limits(
        self, line: Line, train: Train, restrictions: Sequence[SpeedLimit] = ()
    ) -> tuple[Floats, Floats, Floats]:
        """Limits as the front sees them, so wide that the averages keep them: begin, end [m], speed [m/s].

        They overlap; the lowest holds. `restrictions` are limits beside the line's own.
        """
        edges, values = line.capped(train.max_speed_mps).speed_limit_profile(train.length_m)
        begin = np.append(edges[:-1], [r.start_m for r in restrictions])
        end = np.append(edges[1:], [r.end_m + train.length_m for r in restrictions])
        values = np.append(values, [r.limit_mps for r in restrictions])
        wider = 0.5 * self.delay_s * values + LIMIT_MARGIN_M
        return begin - wider, end + wider, np.maximum(values - self.speed_margin_mps, LOWEST_LIMIT_MPS)
