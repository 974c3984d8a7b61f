"""The timetable of a run: the plan's clock, how late the train is, and when a new plan is wanted and taken.

Departure is due `departure_s` after the unit is READY for the first time, arrival `journey.time_s` after
that. A new plan is asked for when the train is more than `threshold_s` off its plan, when it was stopped or
slowed by others, and when a speed restriction comes up. It is taken `take_after_s` later, at the beginning
of a cycle; until then the old one holds. A plan that comes too late, or that no longer fits where the train
is, is dropped.
"""

from __future__ import annotations

from typing import NamedTuple

from controller.config import ControllerConfig
from controller.planning import Plan, drive_delay, reference_table
from controller.profile.comfort import Comfort
from controller.profile.reference import ReferenceTable
from controller.replanning import Answer, PlanSource, Request, Start, past_s
from hil.railway import Journey, SpeedLimit

NS_PER_S = 1_000_000_000
SLACK_S = 0.2
"""How much later than meant a plan may still be taken: that long nothing in it differs from the old one."""
ON_PLAN_MPS = 0.3
"""Nearer than this to the plan's speed, the train is on it."""
SLOWEST_MPS = 1.0
HARDEST_MPS2 = 0.3
"""A train off its plan gets a new one when it is no slower and no longer braked harder than this."""
AGAIN_S = 1.0
"""A plan that was dropped is asked for again so much later."""
FITS_MPS = 1.0
MOST_RESTRICTIONS = 8


class Movement(NamedTuple):
    """Where the train is and what it does, as far as a new plan depends on it."""

    position_m: float
    speed_mps: float
    reference_mps: float
    wanted_mps2: float
    """Acceleration that the last cycle asked for."""
    recovering: bool
    """After an override the demand still rises."""
    standing: bool


class _Pending(NamedTuple):
    request: Request
    zero_ns: int
    take_ns: int
    wanted: bool
    """Asked for because of a restriction, not of the timetable."""
    by_others: bool
    """The train was held, slowed or restricted: what the timetable asks is no longer possible."""


class Timetable:
    """One run's timetable; times are those of the unit's clock [ns]."""

    def __init__(self, journey: Journey, config: ControllerConfig, first: Plan, source: PlanSource) -> None:
        train = journey.train
        self.table: ReferenceTable = reference_table(first.profile, train, config.feed_forward)
        self._source = source
        self._config = config.replanning
        self._release_ns = _ns(config.hold.release_s)
        self._time_ns = _ns(journey.time_s)
        self._lead_s = drive_delay(train, config.feed_forward).total_s
        self._comfort = Comfort.of(train, config.profile)
        self._jerk_mps3 = config.profile.jerk_mps3 or train.comfort_jerk_mps3
        self._horizon_s = config.replanning.take_after_s + SLACK_S + self._lead_s + 2.0 * config.period_s
        self._zero_ns: int | None = None  # where the plan's clock shows 0
        self._on_time_ns: int | None = None  # where it would, if the train were on time
        self._departed_ns: int | None = None
        self._arrival_ns = 0
        self._allowed_ns = 0
        self._pending: _Pending | None = None
        self._wanted = False
        self._by_others = False
        self._last_request_ns: int | None = None
        self._restrictions: dict[int, SpeedLimit] = {}
        self._number = 0
        self._base = 0

    @property
    def plan_number(self) -> int:
        """Number of the plan in use; the first is 0."""
        return self._base

    def since_s(self, now_ns: int) -> float:
        """Time on the plan's clock [s]; 0 before departure, negative while the holding brake releases."""
        return 0.0 if self._zero_ns is None else (now_ns - self._zero_ns) / NS_PER_S

    def lateness_s(self, now_ns: int, position_m: float) -> float:
        """How late the train is against its plan [s]; 0 before departure."""
        if self._zero_ns is None or self._on_time_ns is None:
            return 0.0
        due_s = (now_ns - self._on_time_ns) / NS_PER_S
        return due_s - self.table.plan_time_s(position_m, self.since_s(now_ns))

    def allowed_s(self) -> float:
        """From departure to the latest arrival that others than this unit leave room for [s]; 0 before it.

        That is by the timetable, or as early as was still possible after the train had been held or
        restricted.
        """
        return 0.0 if self._departed_ns is None else (self._allowed_ns - self._departed_ns) / NS_PER_S

    def ready(self, now_ns: int) -> None:
        """The unit is READY; the first time, the clock of the timetable is set."""
        if self._on_time_ns is None:
            due_ns = now_ns + _ns(self._config.departure_s)
            self._arrival_ns = self._allowed_ns = due_ns + self._time_ns
            self._on_time_ns = due_ns + self._release_ns

    def restrict(self, number: int, limit: SpeedLimit) -> None:
        """A temporary speed restriction is in force; the same number again replaces it."""
        if self._restrictions.get(number) != limit and (
            number in self._restrictions or len(self._restrictions) < MOST_RESTRICTIONS
        ):
            self._restrictions[number] = limit
            self._wanted = self._by_others = True

    def held_up(self) -> None:
        """The supervision has slowed or stopped the train."""
        self._by_others = True

    def depart(self, now_ns: int, position_m: float) -> None:
        """The order to depart has come; the plan's clock begins when the holding brake is released."""
        if self._departed_ns is None:
            self._departed_ns = now_ns
        self._zero_ns = now_ns + self._release_ns
        self._pending = None
        if not self._config.enabled or self._on_time_ns is None:
            return
        passed_s = self.table.plan_time_s(position_m, 0.0)
        late_s = (self._zero_ns - self._on_time_ns) / NS_PER_S - passed_s
        self._by_others = True  # held by those who order the departure
        if self._wanted or abs(late_s) > self._config.threshold_s:
            self._ask_standing(now_ns, position_m)

    def update(self, now_ns: int, train: Movement) -> Start | None:
        """While the train runs on its plan: take a plan that is due, or ask for one.

        Returns what the plan begins with that was taken in this cycle.
        """
        if not self._config.enabled or self._zero_ns is None:
            return None
        pending = self._pending
        if pending is not None:
            taken = now_ns >= pending.take_ns and self._take(now_ns, train, pending)
            return pending.request.start if taken else None
        last = self._last_request_ns
        rested_s = float("inf") if last is None else (now_ns - last) / NS_PER_S
        due = self._wanted and rested_s >= AGAIN_S
        if not due and rested_s >= self._config.interval_s:
            due = abs(self.lateness_s(now_ns, train.position_m)) > self._config.threshold_s
        if due:
            self._ask(now_ns, train)
        return None

    def use(self, source: PlanSource) -> None:
        """Have new plans from another source."""
        self._source.close()
        self._source = source

    def work(self) -> None:
        """Between two cycles: let a source without a process of its own solve."""
        self._source.work()

    def close(self) -> None:
        """End the source."""
        self._source.close()

    def _ask(self, now_ns: int, train: Movement) -> None:
        """Ask for a plan for a train that is under way, if its state allows one now."""
        clock_s = self.table.plan_time_s(train.position_m, self.since_s(now_ns))
        if train.standing:
            self._ask_standing(now_ns, train.position_m)
            return
        if clock_s + self._horizon_s >= self.table.braking_from_s:
            return
        if not train.recovering and abs(train.reference_mps - train.speed_mps) <= ON_PLAN_MPS:
            zero_ns = now_ns - _ns(clock_s)
            self._post(now_ns, zero_ns, Start.ON_PLAN, clock_s=clock_s + self._horizon_s)
            return
        if train.speed_mps < SLOWEST_MPS or train.wanted_mps2 < -HARDEST_MPS2:
            return
        ahead_s = self._config.take_after_s
        rise = self._jerk_mps3 * ahead_s if train.recovering else 0.0
        comfort = self._comfort
        then = min(max(train.wanted_mps2 + rise, -comfort.braking_mps2), comfort.acceleration_mps2)
        mean = 0.5 * (train.wanted_mps2 + then)
        self._post(
            now_ns,
            now_ns + _ns(ahead_s) - _ns(past_s(comfort)),
            Start.MOVING,
            position_m=train.position_m + (train.speed_mps + 0.5 * mean * ahead_s) * ahead_s,
            speed_mps=train.speed_mps + mean * ahead_s,
            acceleration_mps2=then,
        )

    def _ask_standing(self, now_ns: int, position_m: float) -> None:
        """Ask for a plan from a stand; the train waits for it."""
        soonest_ns = now_ns + _ns(self._config.take_after_s + SLACK_S + self._lead_s)
        self._zero_ns = max(now_ns, self._zero_ns or 0, soonest_ns)
        self._post(now_ns, self._zero_ns, Start.STANDING, position_m=position_m)

    def _post(
        self,
        now_ns: int,
        zero_ns: int,
        start: Start,
        *,
        clock_s: float = 0.0,
        position_m: float = 0.0,
        speed_mps: float = 0.0,
        acceleration_mps2: float = 0.0,
    ) -> None:
        self._number += 1
        request = Request(
            number=self._number,
            start=start,
            base=self._base,
            clock_s=clock_s,
            position_m=position_m,
            speed_mps=speed_mps,
            acceleration_mps2=acceleration_mps2,
            end_clock_s=(self._arrival_ns - zero_ns) / NS_PER_S,
            restrictions=tuple(self._restrictions.values()),
        )
        self._pending = _Pending(
            request, zero_ns, now_ns + _ns(self._config.take_after_s), self._wanted, self._by_others
        )
        self._wanted = self._by_others = False
        self._last_request_ns = now_ns
        self._source.post(request)

    def _take(self, now_ns: int, train: Movement, pending: _Pending) -> bool:
        """Take the plan if it is there and fits; drop it if it does not, or not any more."""
        answer = self._source.poll(pending.request.number)
        if answer is None:
            if now_ns > pending.take_ns + _ns(SLACK_S):
                self._drop(pending)
            return False
        self._pending = None
        if answer.table is None:
            self._by_others = self._by_others or pending.by_others
            return False
        if not self._fits(now_ns, train, pending):
            self._drop(pending)
            return False
        self.table = answer.table
        self._base = pending.request.number
        self._zero_ns = self._on_time_ns = pending.zero_ns
        if pending.by_others:
            planned_ns = pending.zero_ns + _ns(self.table.duration_s)
            self._allowed_ns = max(self._allowed_ns, planned_ns)
        return True

    def _drop(self, pending: _Pending) -> None:
        self._pending = None
        self._wanted = self._wanted or pending.wanted
        self._by_others = self._by_others or pending.by_others

    def _fits(self, now_ns: int, train: Movement, pending: _Pending) -> bool:
        """Whether the train is still where the new plan begins to differ, or continues from."""
        request = pending.request
        if request.start is Start.STANDING:
            return train.standing and now_ns <= pending.zero_ns - _ns(self._lead_s)
        if request.start is Start.ON_PLAN:
            clock_s = self.table.plan_time_s(train.position_m, self.since_s(now_ns))
            return clock_s + self._lead_s <= request.clock_s
        return abs(train.speed_mps - request.speed_mps) <= FITS_MPS


class PlansOf:
    """The plan source of a twin: what another timetable has taken, and nothing else."""

    def __init__(self, other: Timetable) -> None:
        self._other = other

    def post(self, request: Request) -> None:
        """The other one has asked already."""

    def poll(self, number: int) -> Answer | None:
        """The plan in use there, if it is the answer to the request of this number."""
        other = self._other
        return Answer(number, other.table) if other.plan_number == number else None

    def work(self) -> None:
        """Nothing to do."""

    def close(self) -> None:
        """Nothing to close."""


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)
