"""A new plan for a train that is on its way: from where it is, as it moves, to the stop.

A comfortable plan is the average of a sharp one over the time that lies just behind
(:mod:`controller.profile.comfort`). So the sharp plan is cut at some moment and another one is put on:
whatever follows, the average up to that moment stays what it was, and position, speed, acceleration and jerk
go on without a step. What is averaged behind a train that is on no plan, because a fault has slowed it, is a
run of constant acceleration that leads to where it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple, Protocol

import numpy as np

from controller.config import ControllerConfig
from controller.planning import CLOCK_LEADS_S, Plan, plan, reference_columns
from controller.profile import ProfileError, SpeedProfile
from controller.profile.comfort import Comfort
from controller.profile.optimal import OptimalPlanner, SharpStart
from controller.profile.profile import Floats
from controller.profile.reference import Columns, ReferenceTable
from hil.railway import Journey, SpeedLimit

STEP_ALLOWANCE = 1.02
PAUSE_TRIALS = 28
SETTLING_S = 0.1
"""Some steps of the averages' grid more than they look back."""


class Start(IntEnum):
    """What a new plan begins with."""

    STANDING = 0
    """The train stands at `position_m`; the clock begins at 0 with it."""
    ON_PLAN = 1
    """The train follows plan `base`, which stays as it is until its clock shows `clock_s`."""
    MOVING = 2
    """The train is at `position_m` with this speed and acceleration when the clock shows `past_s`."""


class Request(NamedTuple):
    """What the control loop asks for. `end_clock_s`: what the new plan's clock should show on arrival."""

    number: int
    start: Start
    base: int
    clock_s: float
    position_m: float
    speed_mps: float
    acceleration_mps2: float
    end_clock_s: float
    restrictions: tuple[SpeedLimit, ...] = ()


class Answer(NamedTuple):
    """The new plan's table; None: there is none, and the old one stays (`why`)."""

    number: int
    table: ReferenceTable | None
    why: str = ""


class PlanSource(Protocol):
    """Where new plans come from. None of these calls waits in a process that keeps real time."""

    def post(self, request: Request) -> None:
        """Ask for a plan; an older request that is not answered yet is forgotten."""

    def poll(self, number: int) -> Answer | None:
        """The answer to this request, None while there is none."""

    def work(self) -> None:
        """Between two cycles, outside the timed part."""

    def close(self) -> None:
        """Let go of everything."""


class SynchronousSource:
    """Solves in this process, between two cycles or at the latest when the answer is wanted.

    This is the source of a run in lockstep: an answer is there in the cycle in which it is to be taken,
    whatever the machine, so the same run gives the same frames.
    """

    def __init__(self, replanner: Replanner) -> None:
        self._replanner = replanner
        self._request: Request | None = None
        self._answer: Answer | None = None

    def post(self, request: Request) -> None:
        """Keep the request for the end of the cycle."""
        self._request, self._answer = request, None

    def poll(self, number: int) -> Answer | None:
        """The answer, solved now if it was not before."""
        self.work()
        answer = self._answer
        return answer if answer is not None and answer.number == number else None

    def work(self) -> None:
        """Solve what was asked for in the cycle that has ended."""
        request, self._request = self._request, None
        if request is not None:
            solved = self._replanner.solve(request)
            table = None if solved.columns is None else ReferenceTable.of_columns(solved.columns)
            self._answer = Answer(request.number, table, solved.why)

    def close(self) -> None:
        """Nothing to let go of."""


class Solved(NamedTuple):
    """A request solved: the new plan as columns, or why there is none."""

    columns: Columns | None
    why: str = ""


class Replanner:
    """Makes plans of one journey, and keeps them: a new plan may go on from any of them."""

    def __init__(self, journey: Journey, config: ControllerConfig, first: Plan | None = None) -> None:
        self._journey = journey
        self._config = config
        self.comfort = Comfort.of(journey.train, config.profile)
        self._sharp = {0: (first or plan(journey, config)).sharp}

    def solve(self, request: Request) -> Solved:
        """Solve a request."""
        try:
            sharp = self.sharp(request)
        except ProfileError as error:
            return Solved(None, str(error))
        self._sharp[request.number] = sharp
        leads_s = CLOCK_LEADS_S if request.start is Start.STANDING else 0.0
        columns = reference_columns(
            self.comfort.smoothed(sharp), self._journey.train, self._config.feed_forward, start_s=leads_s
        )
        return Solved(columns)

    def sharp(self, request: Request) -> SpeedProfile:
        """The sharp plan of a request, its past included; ProfileError: no plan can go on from there."""
        if request.start is Start.STANDING:
            begin = SharpStart(request.position_m)
            return self._ahead(begin, request.end_clock_s - self.comfort.delay_s, request.restrictions)
        if request.start is Start.MOVING:
            past = moving_past(self.comfort, request.position_m, request.speed_mps, request.acceleration_mps2)
        else:
            past = _until(self._sharp[request.base], request.clock_s)
        return self._continued(past, request)

    def _continued(self, past: _Past, request: Request) -> SpeedProfile:
        """The past, and the plan of least energy from its end; if need be after a while of constant speed."""
        wanted_s = request.end_clock_s - self.comfort.delay_s - float(past.time_s[-1])
        begin = SharpStart(float(past.position_m[-1]), float(past.speed_mps[-1]))
        ahead = self._ahead(begin, wanted_s, request.restrictions)
        pause_s = self._pause_s(past, ahead)
        if pause_s == 0.0:
            return _joined(past, ahead)
        held = past.held(pause_s)
        later = SharpStart(float(held.position_m[-1]), begin.speed_mps)
        try:
            return _joined(held, self._ahead(later, wanted_s - pause_s, request.restrictions))
        except ProfileError:  # no room for it: rather a jolt than a plan that ends beyond the stop
            return _joined(past, ahead)

    def _pause_s(self, past: _Past, ahead: SpeedProfile) -> float:
        """The least time of constant speed between past and plan that keeps the jerk, at most one window.

        No longer: the plan that the train is on may be about to brake for a limit.
        """
        longest = self.comfort.window_s
        if self._keeps_jerk(past, ahead):
            return 0.0
        for pause_s in np.linspace(0.0, longest, PAUSE_TRIALS)[1:-1]:
            if self._keeps_jerk(past.held(float(pause_s)), ahead):
                return float(pause_s)
        return longest

    def _ahead(self, begin: SharpStart, wanted_s: float, restrictions: Sequence[SpeedLimit]) -> SpeedProfile:
        planner = OptimalPlanner(
            self._journey, self._config.profile, start=begin, restrictions=restrictions, solver="ip"
        )
        return planner.plan_at_most(wanted_s)

    def _keeps_jerk(self, past: _Past, ahead: SpeedProfile) -> bool:
        """Whether the acceleration changes little enough within a window across the joint."""
        before = past.accelerations(self.comfort.window_s)
        after = ahead.acceleration_mps2[:-1][ahead.time_s[:-1] < self.comfort.window_s]
        step = STEP_ALLOWANCE * self.comfort.largest_step_mps2
        return bool(max(before.max() - after.min(), after.max() - before.min()) <= step)


class _Past(NamedTuple):
    """A sharp plan up to now: three arrays of one length."""

    time_s: Floats
    position_m: Floats
    speed_mps: Floats

    def held(self, pause_s: float) -> _Past:
        """The same with its last speed kept for so long."""
        speed = self.speed_mps[-1]
        return _Past(
            np.append(self.time_s, self.time_s[-1] + pause_s),
            np.append(self.position_m, self.position_m[-1] + speed * pause_s),
            np.append(self.speed_mps, speed),
        )

    def accelerations(self, window_s: float) -> Floats:
        """Accelerations of the last `window_s`."""
        lately = self.time_s[1:] > self.time_s[-1] - window_s
        slopes: Floats = (np.diff(self.speed_mps) / np.diff(self.time_s))[lately]
        return slopes


def moving_past(comfort: Comfort, position_m: float, speed_mps: float, acceleration_mps2: float) -> _Past:
    """A run of constant acceleration whose average ends at this place, with this speed and acceleration.

    It lasts `past_s`. With u the mean age of all moments averaged, (T + S)/2, and (T^2 + S^2)/12 + u^2 their
    mean square, the sharp run is a u faster than its average and ahead of it as below. The acceleration is
    limited so that the run does not begin backward.
    """
    whole, mean = past_s(comfort), 0.5 * comfort.delay_s
    square = (comfort.window_s**2 + comfort.smoothing_s**2) / 12.0 + mean**2
    most = 0.98 * speed_mps / (whole - mean)
    a = min(max(acceleration_mps2, -most), most)
    end_mps = speed_mps + a * mean
    end_m = position_m + end_mps * mean - 0.5 * a * square
    before = np.linspace(whole, 0.0, 9)
    return _Past(whole - before, end_m - end_mps * before + 0.5 * a * before**2, end_mps - a * before)


def past_s(comfort: Comfort) -> float:
    """What the clock of a plan shows that begins while the train is moving."""
    return comfort.delay_s + SETTLING_S


def _until(sharp: SpeedProfile, clock_s: float) -> _Past:
    """A sharp plan up to this time of its clock; ProfileError if it stands by then."""
    if not 0.0 < clock_s < sharp.duration_s:
        raise ProfileError(f"the plan ends at {sharp.duration_s:g} s, before {clock_s:g} s")
    k = int(np.searchsorted(sharp.time_s, clock_s, side="left"))
    dt = clock_s - sharp.time_s[k - 1]
    slope = (sharp.speed_mps[k] - sharp.speed_mps[k - 1]) / (sharp.time_s[k] - sharp.time_s[k - 1])
    before = sharp.speed_mps[k - 1]
    return _Past(
        np.append(sharp.time_s[:k], clock_s),
        np.append(sharp.position_m[:k], sharp.position_m[k - 1] + dt * (before + 0.5 * slope * dt)),
        np.append(sharp.speed_mps[:k], before + slope * dt),
    )


def _joined(past: _Past, ahead: SpeedProfile) -> SpeedProfile:
    time = np.concatenate((past.time_s, past.time_s[-1] + ahead.time_s[1:]))
    speed = np.concatenate((past.speed_mps, ahead.speed_mps[1:]))
    interval = np.diff(speed) / np.diff(time)
    return SpeedProfile(
        np.concatenate((past.position_m, ahead.position_m[1:])),
        speed,
        np.append(interval, interval[-1:]),
        time,
    )
