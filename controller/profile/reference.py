"""The reference: what the plan wants at the train's position, so that a late train follows the same curve.

Position-based, but for the first seconds: at standstill a reference over position asks for no speed at
all, so the plan's own clock leads until `start_s`. From then on the plan waits for the train.

The preview undoes the drive: with dead time and first-order lag between demand and acceleration, the
demand `a(t + dead time) + lag da/dt(t + dead time)` makes the train follow `a(t)`. At low speed the slower
friction brake takes over from the motors, and its dead time and lag with it.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from math import ceil, floor, inf, sqrt
from typing import NamedTuple, Self

import numpy as np

from controller.laws import Reference
from controller.profile.profile import Floats, SpeedProfile

STEP_S = 0.02
"""Step of the table over time that the preview is read from."""


class Delay(NamedTuple):
    """What lies between a demand and its effect: a dead time, then a first-order lag."""

    dead_time_s: float
    lag_s: float

    @property
    def total_s(self) -> float:
        """Both together [s]."""
        return self.dead_time_s + self.lag_s


class Columns(NamedTuple):
    """What a table consists of: numbers and four columns over the plan's clock, lists or memory views.

    `position_m`, `speed_mps` and `acceleration_mps2` every `step_s` from 0; `preview_mps2` begins `ahead`
    steps sooner. While the train stands the clock leads until `start_s`.
    """

    step_s: float
    ahead: int
    start_s: float
    braking_from_s: float
    position_m: Sequence[float]
    speed_mps: Sequence[float]
    acceleration_mps2: Sequence[float]
    preview_mps2: Sequence[float]


def columns_of(
    profile: SpeedProfile,
    *,
    drive: Delay,
    friction: Delay | None = None,
    friction_share: Callable[[float], float] = lambda _: 0.0,
    start_s: float = 4.0,
) -> Columns:
    """Columns of a profile; parameters as of :class:`ReferenceTable`."""
    braking_from_s = _last_braking_s(profile)
    count = max(2, round(profile.duration_s / STEP_S))
    step_s = profile.duration_s / count
    time = np.linspace(0.0, profile.duration_s, count + 1)
    position, speed = _resampled(profile, time)
    ahead = ceil(drive.total_s / step_s)
    early: Floats = step_s * np.arange(-ahead, count + 1, dtype=np.float64)
    preview = _preview(profile, early, drive)
    if friction is not None:
        shares = [friction_share(float(v)) for v in profile.speed_mps]
        share = np.interp(early + drive.total_s, profile.time_s, shares)
        braking = np.interp(early + drive.total_s, profile.time_s, profile.acceleration_mps2) < 0.0
        share = np.where(braking & (early >= braking_from_s), share, 0.0)
        preview = (1.0 - share) * preview + share * _preview(profile, early, friction)
    return Columns(
        step_s=step_s,
        ahead=ahead,
        start_s=min(start_s, 0.25 * profile.duration_s),
        braking_from_s=braking_from_s,
        position_m=position.tolist(),
        speed_mps=speed.tolist(),
        acceleration_mps2=np.interp(time, profile.time_s, profile.acceleration_mps2).tolist(),
        preview_mps2=preview.tolist(),
    )


class ReferenceTable:
    """Looks a profile up by position, in a few microseconds and without state.

    `duration_s` is that of the profile, `stop_m` its end; from `braking_from_s` on it brakes to the stop.
    `drive` undoes the drive's delay, `friction` that of the friction brake, which does the share
    `friction_share(speed)` of the braking; `start_s`: how long the clock leads.
    """

    def __init__(
        self,
        profile: SpeedProfile,
        *,
        drive: Delay,
        friction: Delay | None = None,
        friction_share: Callable[[float], float] = lambda _: 0.0,
        start_s: float = 4.0,
    ) -> None:
        self._take(
            columns_of(
                profile, drive=drive, friction=friction, friction_share=friction_share, start_s=start_s
            )
        )

    @classmethod
    def of_columns(cls, columns: Columns) -> Self:
        """A table over columns that exist already; nothing is copied."""
        table = cls.__new__(cls)
        table._take(columns)
        return table

    def _take(self, columns: Columns) -> None:
        self._step_s = columns.step_s
        self._ahead = columns.ahead
        self._start_s = columns.start_s
        self.braking_from_s = columns.braking_from_s
        self._position = columns.position_m
        self._speed = columns.speed_mps
        self._acceleration = columns.acceleration_mps2
        self._preview = columns.preview_mps2
        self._last = len(columns.position_m) - 1
        self._asked = (inf, inf)
        self._answer_s = 0.0
        self.duration_s = self._last * self._step_s
        self.stop_m = float(columns.position_m[self._last])

    @property
    def rows(self) -> int:
        """Length of its longest column."""
        return len(self._preview)

    def plan_time_s(self, position_m: float, since_departure_s: float) -> float:
        """Where on the plan's clock the train is [s]; before departure, how long until then (negative)."""
        asked = (position_m, since_departure_s)
        if asked != self._asked:  # mode, lateness and reference ask the same within a cycle
            self._answer_s = self._plan_time_s(position_m, since_departure_s)
            self._asked = asked
        return self._answer_s

    def _plan_time_s(self, position_m: float, since_departure_s: float) -> float:
        position = self._position
        k = bisect_right(position, position_m) - 1
        if since_departure_s < 0.0:
            return since_departure_s
        if k < 0:
            passed = 0.0
        elif k >= self._last:
            return self._last * self._step_s
        else:
            v0, v1 = self._speed[k], self._speed[k + 1]
            share = (position_m - position[k]) / (position[k + 1] - position[k])
            v = sqrt(v0 * v0 + share * (v1 * v1 - v0 * v0))
            # Constant acceleration inside the step: time into it is distance over mean speed.
            passed = (k + (share * (v0 + v1) / (v0 + v) if v0 + v > 0.0 else share)) * self._step_s
        return max(passed, min(since_departure_s, self._start_s))

    def at(self, position_m: float, since_departure_s: float) -> Reference:
        """The reference for a train here, that long after departure."""
        time_s = self.plan_time_s(position_m, since_departure_s)
        place = time_s / self._step_s
        if place >= self._last:
            return Reference(self.stop_m, 0.0, 0.0, 0.0)
        k = floor(place)
        share = place - k
        j = k + self._ahead
        if j < 0:
            return Reference(position_m, 0.0, 0.0, 0.0)
        preview = self._preview[j] + share * (self._preview[j + 1] - self._preview[j])
        if k < 0:
            return Reference(position_m, 0.0, 0.0, preview)
        speed, acceleration = self._speed, self._acceleration
        return Reference(
            position_m,
            speed[k] + share * (speed[k + 1] - speed[k]),
            acceleration[k] + share * (acceleration[k + 1] - acceleration[k]),
            preview,
        )

    def position_at(self, time_s: float) -> float:
        """Where the plan is at this time of its clock [m]."""
        place = min(max(time_s / self._step_s, 0.0), float(self._last))
        k = min(int(place), self._last - 1)
        return float(self._position[k] + (place - k) * (self._position[k + 1] - self._position[k]))


def _resampled(profile: SpeedProfile, time: Floats) -> tuple[Floats, Floats]:
    """Position and speed at these times; the speed is linear in time between the profile's nodes."""
    k = np.clip(np.searchsorted(profile.time_s, time, side="right") - 1, 0, len(profile.time_s) - 2)
    dt = time - profile.time_s[k]
    slope = (profile.speed_mps[k + 1] - profile.speed_mps[k]) / (profile.time_s[k + 1] - profile.time_s[k])
    position = profile.position_m[k] + dt * (profile.speed_mps[k] + 0.5 * slope * dt)
    position = np.maximum.accumulate(np.clip(position, profile.start_m, profile.end_m))
    position[-1] = profile.end_m
    return position, profile.speed_mps[k] + slope * dt


def _preview(profile: SpeedProfile, clock_s: Floats, delay: Delay) -> Floats:
    """Demand at these times of the plan's clock whose delayed effect is the plan's acceleration."""
    time = clock_s + delay.dead_time_s
    acceleration = np.interp(time, profile.time_s, profile.acceleration_mps2, left=0.0, right=0.0)
    jerk = np.gradient(profile.acceleration_mps2, profile.time_s)
    change = np.interp(time, profile.time_s, jerk, left=0.0, right=0.0)
    demand: Floats = acceleration + delay.lag_s * change
    return demand


def _last_braking_s(profile: SpeedProfile) -> float:
    """Time from which on the plan brakes to its stop without a pause [s]."""
    gentle = np.flatnonzero(profile.acceleration_mps2[:-1] > -0.1)
    moving = np.flatnonzero(profile.speed_mps > 0.5)
    before_stop = gentle[gentle <= moving[-1]] if len(moving) else gentle
    return float(profile.time_s[before_stop[-1] + 1]) if len(before_stop) else 0.0
