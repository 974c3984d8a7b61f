"""A train with limits, for studies of papers that have none: effort, power, dead time, jerk limit, lag.

It answers an acceleration command (effort over effective mass) as a drive does; running resistance and track
slow it down. Brakes are one brake; blending and adhesion are left to the bench's plant.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from hil.railway.line import Line
from hil.railway.resistance import GRAVITY_MPS2
from hil.railway.train import DavisCoefficients

__all__ = ["TrainData", "TrainPlant"]


@dataclass(frozen=True, kw_only=True)
class TrainData:
    """What the plant needs, per kilogram of effective mass where it is an effort or a resistance.

    `gravity_share` is mass over effective mass: what a permille of gradient does to the train.
    """

    davis_mps2: DavisCoefficients
    max_acceleration_mps2: float
    max_power_w_per_kg: float
    max_braking_mps2: float
    dead_time_s: float
    lag_s: float
    jerk_mps3: float = math.inf
    gravity_share: float = 1.0
    length_m: float = 0.0

    def traction_mps2(self, speed_mps: float) -> float:
        """Most effort [m/s2] at this speed."""
        if speed_mps * self.max_acceleration_mps2 <= self.max_power_w_per_kg:
            return self.max_acceleration_mps2
        return self.max_power_w_per_kg / speed_mps


class TrainPlant:
    """State and motion of one train on one line (level without one)."""

    def __init__(self, data: TrainData, line: Line | None, *, step_s: float, substeps: int = 10) -> None:
        self.data = data
        self.position_m = 0.0
        self.speed_mps = 0.0
        self.acceleration_mps2 = 0.0
        self.effort_mps2 = 0.0
        self._line = line
        self._inner_s = step_s / substeps
        self._substeps = substeps
        self._waiting = deque([0.0] * (round(data.dead_time_s / step_s) + 1))
        self._limited = 0.0

    def resistance_mps2(self, position_m: float, speed_mps: float) -> float:
        """What running resistance and track slow the train down by at a place and speed [m/s2]."""
        specific = (
            0.0 if self._line is None else self._line.mean_specific_resistance(position_m, self.data.length_m)
        )
        track = specific * 1e-3 * GRAVITY_MPS2 * self.data.gravity_share
        return self.data.davis_mps2.resistance_n(speed_mps) + track

    def advance(self, command_mps2: float) -> None:
        """One step of the control loop with this command, which acts after the dead time."""
        data, h = self.data, self._inner_s
        self._waiting.append(command_mps2)
        self._waiting.popleft()
        asked = self._waiting[0]
        # Track and resistance hardly change in one step of the loop: at most 3 m of travel.
        resistance = self.resistance_mps2(self.position_m, self.speed_mps)
        for _ in range(self._substeps):
            possible = min(max(asked, -data.max_braking_mps2), data.traction_mps2(self.speed_mps))
            most = data.jerk_mps3 * h
            self._limited += min(max(possible - self._limited, -most), most)
            self.effort_mps2 += h / data.lag_s * (self._limited - self.effort_mps2)
            acceleration = self.effort_mps2 - resistance
            speed = self.speed_mps + h * acceleration
            if speed <= 0.0:  # brakes and resistance hold a train, they do not push it back
                speed = 0.0
                acceleration = min(0.0, -self.speed_mps / h)
            self.position_m += h * 0.5 * (self.speed_mps + speed)
            self.speed_mps = speed
            self.acceleration_mps2 = acceleration
