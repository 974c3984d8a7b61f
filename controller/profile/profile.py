"""A speed profile over position: what every planner makes and the reference follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class ProfileError(ValueError):
    """No profile exists for this journey: says why, with the value and its limit."""

    exit_code = 2


@dataclass(frozen=True)
class SpeedProfile:
    """Speed, acceleration and time over position, from standstill to standstill.

    Shapes: four arrays of one length n >= 3. `time_s` starts at 0 and ascends strictly, `position_m` never
    descends. Between two nodes the speed is linear in time. ProfileError if the arrays contradict.
    """

    position_m: Floats
    speed_mps: Floats
    acceleration_mps2: Floats
    time_s: Floats

    def __post_init__(self) -> None:
        arrays = (self.position_m, self.speed_mps, self.acceleration_mps2, self.time_s)
        if len({len(a) for a in arrays}) != 1 or len(self.time_s) < 3:
            raise ProfileError(f"profile: lengths {[len(a) for a in arrays]} must be equal and at least 3")
        if not all(np.all(np.isfinite(a)) for a in arrays):
            raise ProfileError("profile: every value must be finite")
        if self.time_s[0] != 0.0 or np.any(np.diff(self.time_s) <= 0.0):
            raise ProfileError("profile: time_s must start at 0 and ascend")
        if np.any(np.diff(self.position_m) < 0.0) or np.any(self.speed_mps < 0.0):
            raise ProfileError("profile: position_m must not descend, speed_mps must not be negative")
        for array in arrays:
            array.setflags(write=False)

    @property
    def duration_s(self) -> float:
        """Time from departure to standstill [s]."""
        return float(self.time_s[-1])

    @property
    def start_m(self) -> float:
        """Where it starts [m]."""
        return float(self.position_m[0])

    @property
    def end_m(self) -> float:
        """The stop point [m]."""
        return float(self.position_m[-1])

    @classmethod
    def from_speeds(cls, position_m: Floats, speed_mps: Floats) -> SpeedProfile:
        """Profile through given speeds with constant acceleration between the positions.

        This is how a planner over a position mesh states its result. ProfileError where two neighbours
        are both at standstill, which would take for ever.
        """
        mean = 0.5 * (speed_mps[1:] + speed_mps[:-1])
        if np.any(mean <= 0.0):
            at = float(position_m[int(np.argmax(mean <= 0.0))])
            raise ProfileError(f"profile: the train stands at {at:g} m and never leaves")
        distance = np.diff(position_m)
        time = np.concatenate(([0.0], np.cumsum(distance / mean)))
        interval = np.diff(speed_mps) * mean / distance
        acceleration = np.concatenate((interval, interval[-1:]))
        return cls(position_m, speed_mps, acceleration, time)

    def smoothed(self, window_s: float, step_s: float = 0.02) -> SpeedProfile:
        """The profile with its speed averaged over `window_s` of time, on an even time grid.

        Steps of the acceleration become ramps of that length, so the jerk is bounded by the step over
        `window_s`; distance and end points stay exact, and the duration grows by `window_s`.
        """
        duration = self.duration_s + window_s
        count = int(np.ceil(duration / step_s)) + 1
        time = np.linspace(0.0, duration, count)
        before = time - window_s
        speed = (self._position_at(time) - self._position_at(before)) / window_s
        position = (self._position_integral_at(time) - self._position_integral_at(before)) / window_s
        acceleration = (self._speed_at(time) - self._speed_at(before)) / window_s
        speed = np.maximum(speed, 0.0)
        speed[0] = speed[-1] = 0.0
        position[0], position[-1] = self.start_m, self.end_m
        position = np.minimum(np.maximum.accumulate(position), self.end_m)
        return SpeedProfile(position, speed, acceleration, time)

    def _speed_at(self, time: Floats) -> Floats:
        inside: Floats = np.interp(time, self.time_s, self.speed_mps, left=0.0, right=0.0)
        return inside

    def _position_at(self, time: Floats) -> Floats:
        k, dt, slope = self._interval(time)
        return np.asarray(self.position_m[k] + dt * (self.speed_mps[k] + 0.5 * slope * dt))

    def _position_integral_at(self, time: Floats) -> Floats:
        """Integral of the position over time, standing at the start before 0 and at the end after."""
        steps = np.diff(self.time_s)
        slopes = np.diff(self.speed_mps) / steps
        areas = steps * (self.position_m[:-1] + steps * (0.5 * self.speed_mps[:-1] + slopes * steps / 6.0))
        total = np.concatenate(([0.0], np.cumsum(areas)))
        k, dt, slope = self._interval(time)
        inside = total[k] + dt * (self.position_m[k] + dt * (0.5 * self.speed_mps[k] + slope * dt / 6.0))
        outside = np.minimum(time, 0.0) * self.start_m + np.maximum(time - self.duration_s, 0.0) * self.end_m
        return np.asarray(inside + outside)

    def _interval(self, time: Floats) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Interval of each time, clipped to the profile, time into it, and its acceleration."""
        inside = np.clip(time, 0.0, self.duration_s)
        k = np.clip(np.searchsorted(self.time_s, inside, side="right") - 1, 0, len(self.time_s) - 2)
        slope = (self.speed_mps[k + 1] - self.speed_mps[k]) / (self.time_s[k + 1] - self.time_s[k])
        return k, np.asarray(inside - self.time_s[k]), slope
