"""The plain plan: accelerate, cruise, coast, brake, within limits, efforts and jerk.

1. Speed limits as the front of the train sees them (a low limit lasts until its rear has left it), widened
   by half the smoothing distance at both ends.
2. Backward from the stop with the braking and the coasting deceleration, forward with the acceleration that
   drive, gradient and Davis resistance leave: the fastest such run over position (`_sweep`, compiled).
3. Between accelerating and braking at least one smoothing window of constant speed.
4. Average over a time window `T = max(acceleration, braking) / jerk`, so steps of the acceleration become
   ramps of at most `jerk`; then over `smoothing_s`, so steps of the jerk become ramps too.

A later arrival is met first by coasting sooner, down to `coasting_share` of the cruising speed, then by a
lower cruising speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit

from controller.config import ProfileConfig
from controller.profile.comfort import Comfort
from controller.profile.plateau import with_plateaus
from controller.profile.profile import Floats, ProfileError, SpeedProfile
from hil.railway import Journey

MESH_M = 1.0
"""Largest step of the position mesh; the effort of the drive changes little within it."""
TIME_TOLERANCE_S = 1e-3
SPEED_STEP_MPS = 0.05
"""Step of the table of efforts over speed."""


def plain_profile(
    journey: Journey, config: ProfileConfig, *, time_s: float | None = None, dwell_s: float = 0.0
) -> SpeedProfile:
    """The plan with both averages; parameters and errors as of :func:`plain_sharp`."""
    return Comfort.of(journey.train, config).smoothed(
        plain_sharp(journey, config, time_s=time_s, dwell_s=dwell_s)
    )


def plain_sharp(
    journey: Journey, config: ProfileConfig, *, time_s: float | None = None, dwell_s: float = 0.0
) -> SpeedProfile:
    """The sharp plan that, with its averages, arrives after `time_s`, `dwell_s` of it standing.

    `time_s` is the journey's timetable by default.

    Raises ProfileError when that is shorter than :func:`fastest_time_s`, longer than the slowest plan, or
    when the train cannot climb or brake somewhere.
    """
    timetable = journey.time_s if time_s is None else time_s
    wanted = timetable - dwell_s
    planner = _Planner(journey, config)
    fastest = planner.duration_s(0.0)
    if wanted < fastest - TIME_TOLERANCE_S:
        raise ProfileError(
            f"{timetable:g} must be at least {np.ceil((fastest + dwell_s) * 10) / 10:.1f}, the fastest run "
            "within the limits of [controller.profile]"
        )
    slowest = planner.duration_s(2.0)
    if wanted > slowest:
        raise ProfileError(
            f"{timetable:g} must be at most {np.floor((slowest + dwell_s) * 10) / 10:.1f}, "
            "the slowest run that is planned"
        )
    low, high = 0.0, 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        duration = planner.duration_s(middle)
        if abs(duration - wanted) <= TIME_TOLERANCE_S:
            return planner.sharp(middle)
        low, high = (middle, high) if duration < wanted else (low, middle)
    return planner.sharp(0.5 * (low + high))


def fastest_time_s(journey: Journey, config: ProfileConfig) -> float:
    """Shortest time [s] from departure to standstill within the limits of `config`."""
    return _Planner(journey, config).duration_s(0.0)


@dataclass(frozen=True)
class _Ease:
    """How far a plan stays behind the fastest one."""

    top_mps: float
    """Cruising speed."""
    brake_below_mps: float
    """Above this speed the train coasts instead of braking."""


class _Planner:
    """Plans of one journey, from the fastest (ease 0) over coasting (1) to the slowest (2)."""

    def __init__(self, journey: Journey, config: ProfileConfig) -> None:
        train = journey.train
        self._journey = journey
        self._config = config
        self._comfort = Comfort.of(train, config)
        self._mesh, self._limits = self._mesh_and_limits()
        middles = 0.5 * (self._mesh[1:] + self._mesh[:-1])
        track = np.array([journey.line.mean_specific_resistance(x, train.length_m) for x in middles])
        self._track_mps2 = np.array([train.track_resistance_n(n) for n in track]) / train.effective_mass_kg
        top = float(np.max(self._limits))
        speeds = np.arange(0.0, top + 2 * SPEED_STEP_MPS, SPEED_STEP_MPS)
        mass = train.effective_mass_kg
        self._davis_mps2 = np.array([train.running_resistance_n(v) for v in speeds]) / mass
        self._traction_mps2 = (
            config.traction_share * np.array([train.traction_effort_n(v) for v in speeds]) / mass
        )
        self._brake_mps2 = (
            config.brake_share * np.array([train.service_brake_effort_n(v) for v in speeds]) / mass
        )
        self._top_mps = top
        self._top_mps = float(np.max(self.sharp(0.0).speed_mps))

    def duration_s(self, ease: float) -> float:
        return self.sharp(ease).duration_s + self._comfort.delay_s

    def _ease(self, ease: float) -> _Ease:
        top, share = self._top_mps, self._config.coasting_share
        if ease <= 0.0:
            return _Ease(top, np.inf)
        if ease <= 1.0:
            return _Ease(top, top * (1.0 - ease * (1.0 - share)))
        slower = top * max(0.1, 2.0 - ease)
        return _Ease(slower, slower * share)

    def sharp(self, ease: float) -> SpeedProfile:
        """The run with steps in its acceleration."""
        comfort = self._comfort
        chosen = self._ease(ease)
        ceiling = 0.5 * np.minimum(self._limits, chosen.top_mps) ** 2
        energy, fault, where = _sweep(
            self._mesh,
            ceiling,
            self._track_mps2,
            self._davis_mps2,
            self._traction_mps2,
            self._brake_mps2,
            SPEED_STEP_MPS,
            comfort.acceleration_mps2,
            comfort.braking_mps2,
            comfort.stop_braking_mps2,
            comfort.slow_mps,
            chosen.brake_below_mps,
        )
        if fault:
            what = "climb" if fault == _CANNOT_CLIMB else "brake"
            raise ProfileError(
                f"the train cannot {what} at {self._mesh[where]:.0f} m with the shares of its effort that "
                "[controller.profile] allows"
            )
        mesh, speed = with_plateaus(
            self._mesh, np.sqrt(2.0 * energy), comfort.window_s, comfort.largest_step_mps2
        )
        return SpeedProfile.from_speeds(mesh, speed)

    def _mesh_and_limits(self) -> tuple[Floats, Floats]:
        """Mesh nodes, and the limit at each, widened for the smoothing; standstill at both ends."""
        journey = self._journey
        start, end = journey.origin.position_m, journey.destination.position_m
        limits = list(zip(*self._comfort.widened_limits(journey.line, journey.train), strict=True))
        places = {start, end}
        for left, right, _ in limits:
            places |= {p for p in (left, right) if start < p < end}
        places |= {float(p) for p in journey.line.breakpoints() if start < p < end}
        corners = sorted(places)
        mesh = np.concatenate(
            [
                np.linspace(a, b, max(1, int(np.ceil((b - a) / MESH_M))), endpoint=False)
                for a, b in pairwise(corners)
            ]
            + [np.array([end])]
        )
        mesh = _refined_ends(mesh, end - self._comfort.tail_m)
        limit = np.full(len(mesh), np.inf)
        for left, right, v in limits:
            inside = (mesh >= left) & (mesh <= right)
            limit[inside] = np.minimum(limit[inside], v)
        if not np.all(np.isfinite(limit)):
            limit[~np.isfinite(limit)] = min(float(v) for _, _, v in limits)
        limit[0] = limit[-1] = 0.0
        return mesh, limit


def _refined_ends(mesh: Floats, tail_m: float) -> Floats:
    """Finer steps in the first and last metre, where the speed is low, and a node at the soft stop."""
    fine = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75])
    return np.unique(np.concatenate((mesh, mesh[0] + fine, mesh[-1] - fine, [tail_m])))


_CANNOT_CLIMB = 1
_CANNOT_BRAKE = 2


@njit(cache=True)
def _sweep(
    mesh: Floats,
    ceiling: Floats,
    track_mps2: Floats,
    davis_mps2: Floats,
    traction_mps2: Floats,
    brake_mps2: Floats,
    speed_step: float,
    acceleration: float,
    braking: float,
    stop_braking: float,
    slow: float,
    brake_below: float,
) -> tuple[Floats, int, int]:
    """Kinetic energy per mass y = v^2/2 at every node; a fault and its node, or 0.

    With constant acceleration between nodes y is linear in position.
    """
    n = mesh.shape[0]
    y = ceiling.copy()
    y_slow = 0.5 * slow * slow
    y_coast = 0.5 * brake_below * brake_below
    for k in range(n - 2, -1, -1):
        rest = mesh[k + 1] - mesh[k]
        here = y[k + 1]
        v = np.sqrt(2.0 * here)
        drag = _at(davis_mps2, v, speed_step) + track_mps2[k]
        available = _at(brake_mps2, v, speed_step) + drag
        if available < 0.02:
            return y, _CANNOT_BRAKE, k
        full = min(braking, available)
        coasting = min(max(drag, 0.0), full)
        for _ in range(3):  # a step may cross the borders of two regimes
            if here < y_slow:
                rate, border = min(stop_braking, full), y_slow
            elif here < y_coast:
                rate, border = full, y_coast
            else:
                rate, border = coasting, np.inf
            if here + rate * rest <= border:
                here += rate * rest
                break
            rest -= (border - here) / rate
            here = border
        y[k] = min(y[k], here)
    for k in range(n - 1):
        v = np.sqrt(2.0 * y[k])
        gain = _at(traction_mps2, v, speed_step) - _at(davis_mps2, v, speed_step) - track_mps2[k]
        reached = y[k] + min(acceleration, gain) * (mesh[k + 1] - mesh[k])
        if reached <= 0.0 and k + 1 < n - 1:
            return y, _CANNOT_CLIMB, k
        y[k + 1] = min(y[k + 1], max(reached, 0.0))
    return y, 0, 0


@njit(cache=True)
def _at(table: Floats, speed: float, step: float) -> float:
    """Linear interpolation in a table over evenly spaced speeds from 0."""
    place = speed / step
    k = min(int(place), table.shape[0] - 2)
    return table[k] + (place - k) * (table[k + 1] - table[k])  # type: ignore[no-any-return]
