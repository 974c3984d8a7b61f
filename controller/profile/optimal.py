"""The plan of least energy: the optimal profile within comfortable accelerations, then both averages.

1. The energy-optimal profile (:mod:`controller.profile.solve`) for the time that the averages leave, under
the
   speed limits widened as for the plain plan, with the plan's shares of the efforts.
2. The last decimetres with `stop_braking_mps2`, so that the stop is soft.
3. Between traction and brake at least one window of constant speed, where the step would be too large.
4. The two averages of :mod:`controller.profile.comfort`: bounded jerk, without steps.

Steps 2 and 3 cost time; the time given to step 1 is corrected until the whole takes what it may.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controller.config import ProfileConfig
from controller.profile.comfort import Comfort
from controller.profile.interior_point import NotConverged
from controller.profile.plateau import with_plateaus
from controller.profile.problem import Efforts, Problem
from controller.profile.profile import Floats, ProfileError, SpeedProfile
from controller.profile.solution import Solution
from controller.profile.solve import Solver, fastest, solve
from hil.railway import Journey, SpeedLimit

MESH_M = 5.0
FEWEST_STAGES = 1000
"""The step is smaller on a short run: a thousand stages cost a millisecond."""
TIME_TOLERANCE_S = 5e-4
CORRECTIONS = 20
ROUNDING_S = 1e-3
BRAKING_RESERVE = 0.95
"""Share of the planned braking with which a train that is too fast for a limit is let down to it."""
LONGEST = 4.0
"""No plan takes longer than this many times the fastest."""


@dataclass(frozen=True)
class SharpStart:
    """Where a sharp plan begins: at rest at the origin, or moving."""

    position_m: float
    speed_mps: float = 0.0


class OptimalPlanner:
    """Sharp plans of one journey from one start; times are those of the sharp plan, without the averages."""

    def __init__(
        self,
        journey: Journey,
        config: ProfileConfig,
        *,
        start: SharpStart | None = None,
        restrictions: Sequence[SpeedLimit] = (),
        solver: Solver = "auto",
    ) -> None:
        self._solver = solver
        self.comfort = Comfort.of(journey.train, config)
        self.start = start or SharpStart(journey.origin.position_m)
        self._stop_m = journey.destination.position_m
        self._problem = self._of(journey, config, restrictions)
        quickest = fastest(self._problem)
        self._least_s = quickest.trip_time_s
        self._last: Solution | None = None
        self._quickest = self._sharp(quickest)

    @property
    def fastest_s(self) -> float:
        """Least time to standstill [s]."""
        return self._quickest.duration_s

    def fastest(self) -> SpeedProfile:
        """The fastest sharp plan."""
        return self._quickest

    def plan_within(self, timetable_s: float, standing_s: float) -> SpeedProfile:
        """The plan for a timetable of which `standing_s` are spent otherwise; or ProfileError."""
        wanted = timetable_s - standing_s
        if wanted < self.fastest_s - ROUNDING_S:
            raise ProfileError(
                f"{timetable_s:g} must be at least {np.ceil((self.fastest_s + standing_s) * 10) / 10:.1f}, "
                "the fastest run within the limits of [controller.profile]"
            )
        slowest = LONGEST * self.fastest_s
        if wanted > slowest:
            raise ProfileError(
                f"{timetable_s:g} must be at most {np.floor((slowest + standing_s) * 10) / 10:.1f}, "
                "the slowest run that is planned"
            )
        return self.plan(wanted)

    def plan_at_most(self, time_s: float) -> SpeedProfile:
        """The plan that takes `time_s`; the fastest where that is too short, or too long in motion."""
        try:
            return self.plan(min(time_s, LONGEST * self.fastest_s))
        except NotConverged:  # a train that is moving cannot wait: some times are too long for it
            return self._quickest

    def plan(self, time_s: float) -> SpeedProfile:
        """The sharp plan of least energy that takes `time_s`, which must not be less than `fastest_s`."""
        if time_s <= self.fastest_s + TIME_TOLERANCE_S:
            return self._quickest
        tail_s = self.comfort.slow_mps / self.comfort.stop_braking_mps2
        given = time_s - tail_s
        low, high = self._least_s, np.inf
        best = self._quickest
        for _ in range(CORRECTIONS):
            trial = self._solved(given)
            error = trial.duration_s - time_s
            if abs(error) <= TIME_TOLERANCE_S:
                return trial
            if best.duration_s < trial.duration_s < time_s:
                best = trial
            low, high = (low, min(high, given)) if error > 0.0 else (max(low, given), high)
            given -= error
            if not low < given < high:
                given = 0.5 * (low + high)
        # Plateaus make small steps in the time; the rest is met by running a little slower everywhere.
        return best if self.start.speed_mps > 0.0 else _slower(best, best.duration_s / time_s)

    def _solved(self, time_s: float) -> SpeedProfile:
        solution = solve(self._problem.with_time(time_s), self._solver, start=self._last)
        self._last = solution
        return self._sharp(solution)

    def _sharp(self, solution: Solution) -> SpeedProfile:
        """The solution with its soft stop, and with plateaus."""
        comfort = self.comfort
        mesh = solution.problem.position_m + self.start.position_m
        mesh[-1] = self._stop_m - comfort.tail_m
        mesh, speed = with_plateaus(mesh, solution.speed_mps, comfort.window_s, comfort.largest_step_mps2)
        return SpeedProfile.from_speeds(np.append(mesh, self._stop_m), np.append(speed, 0.0))

    def _of(self, journey: Journey, config: ProfileConfig, restrictions: Sequence[SpeedLimit]) -> Problem:
        """The problem up to where the soft stop begins."""
        comfort, train = self.comfort, journey.train
        problem = Problem.of_line(
            journey.line,
            train,
            self.start.position_m,
            self._stop_m - comfort.tail_m,
            max(journey.time_s, 1.0),
            train_length_m=train.length_m,
            max_step_m=min(MESH_M, max(abs(self._stop_m - self.start.position_m), 1.0) / FEWEST_STAGES),
            max_acceleration_mps2=comfort.acceleration_mps2,
            max_deceleration_mps2=comfort.braking_mps2,
            speed_restrictions=[
                SpeedLimit(begin, end - train.length_m, speed)
                for begin, end, speed in zip(
                    *comfort.widened_limits(journey.line, train, restrictions), strict=True
                )
            ],
            start_speed_mps=self.start.speed_mps,
            end_speed_mps=comfort.slow_mps,
        )
        return replace(
            problem,
            traction=_share(problem.traction, config.traction_share),
            max_braking_n=config.brake_share * train.service_brake_effort_n(),
            speed_limit_mps=self._reachable(problem),
        )

    def _reachable(self, problem: Problem) -> Floats:
        """Limits, raised where the train is too fast already: to what it reaches by braking."""
        reserve = 2.0 * BRAKING_RESERVE * self.comfort.braking_mps2 * problem.position_m[:-1]
        braking = np.sqrt(np.maximum(self.start.speed_mps**2 - reserve, 0.0))
        return np.maximum(problem.speed_limit_mps, braking)


def optimal_profile(
    journey: Journey, config: ProfileConfig, *, time_s: float | None = None, dwell_s: float = 0.0
) -> SpeedProfile:
    """The plan of least energy that arrives after `time_s` (the timetable), `dwell_s` of it standing.

    Raises ProfileError when that is shorter than the fastest plan or much longer, or when the train cannot
    climb or brake somewhere.
    """
    timetable = journey.time_s if time_s is None else time_s
    planner = OptimalPlanner(journey, config)
    comfort = planner.comfort
    return comfort.smoothed(planner.plan_within(timetable, dwell_s + comfort.delay_s))


def _slower(profile: SpeedProfile, share: float) -> SpeedProfile:
    """The profile with all speeds times `share`, its times over it: accelerations shrink by its square."""
    return SpeedProfile.from_speeds(profile.position_m, share * profile.speed_mps)


def _share(efforts: Efforts, share: float) -> Efforts:
    """That share of the efforts."""
    force, power = efforts.max_force_n, efforts.max_power_w
    return Efforts(
        None if force is None else share * force,
        None if power is None else share * power,
        tuple((speed, share * effort) for speed, effort in efforts.points),
    )
