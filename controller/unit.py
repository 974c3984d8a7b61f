"""The ATO unit as a node on the bus: inputs in, one law under one supervision, commands out.

One cycle: read the bus, judge it, choose the mode, ask the plan and the law, answer. No I/O and no clock.
"""

from __future__ import annotations

from math import isfinite
from pathlib import Path

from controller.balises import BaliseWatch
from controller.config import ControllerConfig
from controller.effort import EffortMap
from controller.laws import Measurement, Reference, clamp
from controller.laws.selection import LAWS
from controller.modes import DRIVING, Conditions, Mode, next_mode
from controller.outputs import Commands, Outputs
from controller.planning import Plan, drive_of, plan
from controller.profile import ProfileError
from controller.replanning import PlanSource, Replanner, Start, SynchronousSource
from controller.replanning_process import ChildSource
from controller.supervision import Observation, Reaction, Supervisor
from controller.timetable import Movement, PlansOf, Timetable
from controller.warm_up import get_under_way
from hil.canbus.contract import Contract, ContractError
from hil.node.inbox import Inbox, Received
from hil.node.outbox import Outbox, check_period
from hil.node.unit import Probe
from hil.railway import Journey, RailwayDataError, SpeedLimit, load_journey

RECEIVES = ("TCU_Status", "BCU_Status", "ODO_Motion", "ODO_Balise", "ATP_Permission", "ATP_Restriction")
SENDS = ("ATO_Command", "ATO_Status", "ATO_Position", "ATO_Timing", "ATO_Emergency")
TCU_UNABLE = frozenset({4, 5})  # TCU_Status.State: CUT, FAULT
BCU_AGAINST = frozenset({3, 4})  # BCU_Status.State: EMERGENCY, COMMAND_LOST
NS_PER_S = 1_000_000_000
OVERRUN_RAMP_M = 0.01
TELEGRAM_DELAY_S = 0.05  # a balise telegram may be that much older than the motion beside it
MAX_EXTRAPOLATION_NS = 50_000_000  # the silence limit of ODO_Motion; older values are not used anyway

COMMON_PROBES = (
    Probe("reference_speed_mps", "m/s"),
    Probe("reference_acceleration_mps2", "m/s^2"),
    Probe("reference_position_m", "m"),
    Probe("measured_speed_mps", "m/s"),
    Probe("measured_position_m", "m"),
    Probe("speed_error_mps", "m/s"),
    Probe("effort_demand", "1"),
    Probe("mode", ""),
    Probe("supervision", ""),
    Probe("distance_to_stop_m", "m"),
    Probe("lateness_s", "s"),
    Probe("allowed_time_s", "s"),
    Probe("plan_number", ""),
)


def build(scenario: Path, contract: Contract) -> ControllerUnit:
    """The ATO unit of a scenario file.

    Raises RailwayDataError or ProfileError: one line with file, key, value and limit.
    """
    config = ControllerConfig.load(scenario)
    try:
        check_period(
            contract, ControllerUnit.nodes, round(config.period_s * NS_PER_S), ControllerUnit.every_cycle
        )
    except ContractError as error:
        raise RailwayDataError(f"{scenario}: controller.period_s: {error}") from None
    journey = load_journey(scenario)
    try:
        first = plan(journey, config)
    except ProfileError as error:
        raise ProfileError(f"{scenario}: journey.time_s: {error}") from None
    unit = ControllerUnit(journey, config, first, contract)
    unit.scenario = scenario
    return unit


class ControllerUnit:
    """See the module docstring; satisfies :class:`hil.node.unit.Unit`."""

    name = "controller"
    nodes = ("ATO",)
    receives = RECEIVES
    after: tuple[str, ...] = ()
    every_cycle = ("ATO_Command",)

    def __init__(
        self,
        journey: Journey,
        config: ControllerConfig,
        first: Plan,
        contract: Contract,
        source: PlanSource | None = None,
    ) -> None:
        contract.require((*RECEIVES, *SENDS))
        profile = first.profile
        self.period_ns = round(config.period_s * NS_PER_S)
        self._made_of = (journey, config, first, contract)
        self.profile = profile
        self.mode = Mode.STANDBY
        self.scenario: Path | None = None
        self.supervisor = Supervisor(config.supervision, period_s=config.period_s)
        entry = LAWS[config.law]
        self._law = entry.make(config, drive_of(journey.train))
        self.probes = COMMON_PROBES + tuple(Probe(*names) for names in self._law.probe_names)
        self._config = config
        self._period_s = config.period_s
        self._jerk_mps3 = config.profile.jerk_mps3 or journey.train.comfort_jerk_mps3
        self.timetable = Timetable(
            journey, config, first, source or SynchronousSource(Replanner(journey, config, first))
        )
        self._effort = EffortMap(journey.line, journey.train, resistance=config.feed_forward.resistance)
        self._balises = BaliseWatch(
            journey.line.balises,
            start_m=journey.origin.position_m,
            tolerance_m=config.supervision.balise_tolerance_m,
        )
        self._outputs = Outputs(contract, law_number=entry.number)
        self._seen = Observation()
        self._conditions = Conditions()
        self._stop_m = profile.end_m
        self._position_m = profile.start_m
        self._speed_mps = 0.0
        self._reference = Reference(profile.start_m, 0.0, 0.0, 0.0)
        self._demand = 0.0
        self._ceiling_mps2: float | None = None
        self._wanted_mps2 = 0.0
        self._schedule_m = profile.start_m
        self._lateness_s = 0.0
        self._inbox: Inbox | None = None

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """One cycle at `now_ns`."""
        if inbox is not self._inbox:
            self._bind(inbox)
        self._read(inbox)
        seen, supervisor = self._seen, self.supervisor
        before = supervisor.state
        supervisor.update(seen)
        self._choose_mode(now_ns)
        command = self._drive(now_ns)
        if supervisor.state is not before:
            self._outputs.changed(outbox, supervisor.state, self._speed_mps)
        self._outputs.put(
            outbox,
            command,
            mode=self.mode,
            supervision=supervisor.state,
            reference=self._reference._replace(position_m=self._schedule_m),
            speed_error_mps=self._reference.speed_mps - self._speed_mps,
            distance_to_stop_m=self._stop_m - self._position_m,
            odometry_counter=self._motion.counter if self._motion.received else None,
            timing=inbox.timing,
            worst_age_ns=inbox.worst_age_ns(),
        )
        self._demand = command.effort

    def probe(self) -> tuple[float, ...]:
        """Values of the probes after the step."""
        reference = self._reference
        return (
            reference.speed_mps,
            reference.acceleration_mps2,
            self._schedule_m,
            self._speed_mps,
            self._position_m,
            reference.speed_mps - self._speed_mps,
            self._demand,
            float(self.mode),
            float(self.supervisor.state),
            self._stop_m - self._position_m,
            self._lateness_s,
            self.timetable.allowed_s(),
            float(self.timetable.plan_number),
            *self._law.internals(),
        )

    def start_helper(self) -> None:
        """In real time, before the first cycle: plan in a process of its own; PlanningError."""
        if self.scenario is not None and self._config.replanning.enabled:
            self.timetable.use(ChildSource(self.scenario, self.timetable.table.rows))

    def close(self) -> None:
        """End what `start_helper` has started."""
        self.timetable.close()

    def between_cycles(self) -> None:
        """In lockstep, after a cycle has ended: solve what it asked for."""
        self.timetable.work()

    def stop(self, outbox: Outbox) -> None:
        """Leave the train safe: holding brake if it stands, emergency brake if it moves."""
        standing = self._seen.standstill and self._seen.odometry_valid
        self._outputs.leave(outbox, emergency=not standing)

    def warm_up(self) -> None:
        """Compile what is compiled on first use, and let a twin of this unit get under way."""
        reference = self.timetable.table.at(self._position_m, 1.0)
        self._law.step(reference, Measurement(self._position_m, 0.0, -1.0, 1.0), self._period_s)
        self._law.reset()
        get_under_way(self.twin(), self._made_of[-1], self._position_m)

    def twin(self) -> ControllerUnit:
        """Another unit for the same journey that takes over the plans of this one and asks for none."""
        twin = ControllerUnit(*self._made_of, PlansOf(self.timetable))
        twin.timetable.table = self.timetable.table
        return twin

    def _bind(self, inbox: Inbox) -> None:
        self._inbox = inbox
        self._motion: Received = inbox["ODO_Motion"]
        self._balise: Received = inbox["ODO_Balise"]
        self._traction: Received = inbox["TCU_Status"]
        self._brake: Received = inbox["BCU_Status"]
        self._permission: Received = inbox["ATP_Permission"]
        self._restriction: Received = inbox["ATP_Restriction"]

    def _read(self, inbox: Inbox) -> None:
        """Fill in what supervision and law look at; a value that is not finite is not taken."""
        seen = self._seen
        motion, values = self._motion, self._motion.values
        speed, position = values["Speed"], values["Position"]
        finite = isfinite(speed) and isfinite(position)
        seen.odometry_alive = motion.received and not motion.timed_out()
        seen.odometry_valid = bool(values["Valid"]) and not motion.faulty and finite
        seen.odometry_fresh = motion.fresh
        if seen.odometry_valid and seen.odometry_alive:
            age_ns = min(motion.age_ns(), MAX_EXTRAPOLATION_NS)
            self._speed_mps = speed
            self._position_m = position + speed * age_ns / NS_PER_S
        seen.standstill = bool(values["Standstill"])
        seen.slipping = bool(values["Slip"]) or bool(values["Slide"])
        seen.speed_mps = self._speed_mps
        seen.position_m = self._position_m
        seen.distance_to_stop_m = self._stop_m - self._position_m

        seen.traction_alive = self._traction.valid
        seen.brake_alive = self._brake.valid
        seen.traction_able = (
            self._traction.values["State"] not in TCU_UNABLE
            and self._brake.values["State"] not in BCU_AGAINST
        )

        values = self._permission.values
        permitted = values["PermittedSpeed"]
        seen.permission_alive = self._permission.valid and isfinite(permitted)
        if seen.permission_alive:
            seen.permitted_mps = permitted
        seen.departure_authorised = bool(values["DepartureAuthorised"])
        seen.doors_closed = bool(values["DoorsClosed"])
        seen.emergency_stop = bool(values["EmergencyStop"])

        seen.balise_far = False
        if self._balise.events:
            self._read_balises(motion.age_ns())
        for order in self._restriction.events:
            start_m = order["Start"]
            self.timetable.restrict(
                int(order["Number"]), SpeedLimit(start_m, start_m + order["Length"], order["Limit"])
            )
        self._balises.passed(self._position_m)
        seen.balise_missed = self._balises.missed
        seen.deadline_misses = inbox.timing.deadline_misses
        seen.driving = self.mode in DRIVING

    def _read_balises(self, age_ns: int) -> None:
        """Take the telegrams of this cycle; one from far away speaks against the odometry."""
        reach_m = self._config.supervision.balise_tolerance_m
        reach_m += abs(self._speed_mps) * (age_ns / NS_PER_S + TELEGRAM_DELAY_S)
        for telegram in self._balise.events:
            if abs(telegram["Position"] - self._position_m) <= reach_m:
                self._balises.read(int(telegram["Number"]))
            else:
                self._seen.balise_far = True

    def _choose_mode(self, now_ns: int) -> None:
        seen, reaction, conditions = self._seen, self.supervisor.reaction, self._conditions
        complete = seen.complete
        conditions.emergency = reaction is Reaction.EMERGENCY_BRAKE
        conditions.overridden = reaction is Reaction.SERVICE_BRAKE
        conditions.inputs_valid = complete
        conditions.standstill = seen.standstill and seen.odometry_alive and seen.odometry_valid
        conditions.departure = seen.doors_closed and seen.departure_authorised
        at_stop = -self._config.supervision.overrun_m <= seen.distance_to_stop_m <= self._config.hold.window_m
        conditions.arrived = conditions.standstill and at_stop
        timetable = self.timetable
        table = timetable.table
        since = timetable.since_s(now_ns)
        conditions.braking_to_stop = table.plan_time_s(self._position_m, since) >= table.braking_from_s
        mode = next_mode(self.mode, conditions)
        if mode is not self.mode:
            if mode is Mode.READY:
                timetable.ready(now_ns)
            elif mode is Mode.RUN and self.mode is Mode.READY:
                timetable.depart(now_ns, self._position_m)
            elif mode is Mode.DEGRADED or mode is Mode.EMERGENCY:
                timetable.held_up()
            if self.mode in (Mode.READY, Mode.DEGRADED):
                self._law.reset()
            self.mode = mode

    def _drive(self, now_ns: int) -> Commands:
        """The command of this cycle."""
        mode, seen, timetable = self.mode, self._seen, self.timetable
        if mode is Mode.RUN:
            self._replan(now_ns)
        since = timetable.since_s(now_ns)
        driving = mode in DRIVING
        self._lateness_s = timetable.lateness_s(now_ns, self._position_m) if driving else 0.0
        if mode is Mode.HOLD:
            self._schedule_m = self._stop_m
        elif driving:
            self._schedule_m = timetable.table.position_at(since)
        if mode is Mode.RUN or mode is Mode.STOPPING:
            return self._follow(since)
        self._reference = (
            timetable.table.at(self._position_m, since if driving else 0.0)
            if mode is not Mode.HOLD
            else Reference(self._stop_m, 0.0, 0.0, 0.0)
        )
        if mode is Mode.DEGRADED:
            share = self._config.supervision.service_brake_share
            self._ceiling_mps2 = self._wanted_mps2 = self._floor_mps2()
            return Commands(-share, holding=seen.standstill, emergency=False)
        if mode is Mode.EMERGENCY:
            return Commands(0.0, holding=seen.standstill, emergency=True)
        return Commands(0.0, holding=True, emergency=False)

    def _replan(self, now_ns: int) -> None:
        """Ask for a new plan where one is wanted, and take it when it is due."""
        movement = Movement(
            self._position_m,
            self._speed_mps,
            self._reference.speed_mps,
            self._wanted_mps2,
            recovering=self._ceiling_mps2 is not None,
            standing=self._conditions.standstill,
        )
        taken = self.timetable.update(now_ns, movement)
        if taken is Start.STANDING:
            self._law.reset()
        elif taken is Start.MOVING:
            # The train is only about where the plan begins: let no difference show as a jolt.
            self._ceiling_mps2 = self._wanted_mps2

    def _follow(self, since: float) -> Commands:
        """Law and feed-forward, below whatever supervision leaves of them."""
        seen, config, position, speed = self._seen, self._config, self._position_m, self._speed_mps
        reference = self.timetable.table.at(position, since)
        self._reference = reference
        resistance = self._effort.resistance_mps2(position, speed)
        if since < 0.0 and reference.preview_mps2 <= 0.0:
            # The holding brake is still releasing; hold the train on a gradient meanwhile.
            self._wanted_mps2 = 0.0
            return self._limited(self._effort.demand(0.0, resistance, speed), holding=False)
        lowest, highest = self._effort.authority_mps2(speed, resistance)
        ceiling = self._ceiling_mps2
        if ceiling is not None:
            # After an override the demand rises no faster than the comfortable jerk.
            ceiling += self._jerk_mps3 * self._period_s
            self._ceiling_mps2 = ceiling if ceiling < highest else None
            highest = max(lowest, min(highest, ceiling))
        if not config.feed_forward.acceleration:
            reference = reference._replace(preview_mps2=0.0)
        measurement = Measurement(
            position, speed, lowest, highest, resistance, effort_mps2=self._reported_effort_mps2()
        )
        wanted = self._law.step(reference, measurement, self._period_s)
        if seen.distance_to_stop_m < 0.0:
            # Past the stop the plan is over: brake to a stand, gently for the first millimetres.
            share = min(1.0, -seen.distance_to_stop_m / OVERRUN_RAMP_M)
            wanted = min(wanted, -share * config.profile.stop_braking_mps2)
        self._wanted_mps2 = wanted
        demand = self._effort.demand(wanted, resistance, speed)
        at_stop = seen.distance_to_stop_m <= config.hold.window_m and abs(speed) <= config.hold.speed_mps
        return self._limited(demand, holding=at_stop)

    def _reported_effort_mps2(self) -> float | None:
        """What drive and brakes say they give now, signed, over the nominal mass; None if one is silent."""
        if not (self._traction.valid and self._brake.valid):
            return None
        effort_n = self._traction.values["TractiveEffort"] - self._brake.values["PneumaticEffort"]
        return effort_n / self._effort.mass_kg if isfinite(effort_n) else None

    def _limited(self, demand: float, *, holding: bool) -> Commands:
        """What is left of a demand; never more than it, and nothing that is not a finite number."""
        if not isfinite(demand):
            demand = -self._config.supervision.service_brake_share
        demand = clamp(demand, -1.0, 1.0)
        if self.supervisor.reaction is not Reaction.NONE:
            demand = min(demand, 0.0)
            holding = holding or self._seen.standstill
        if holding:
            demand = min(demand, 0.0)
        return Commands(demand, holding=holding, emergency=False)

    def _floor_mps2(self) -> float:
        """Acceleration that the service brake of an override gives now."""
        resistance = self._effort.resistance_mps2(self._position_m, self._speed_mps)
        lowest, _ = self._effort.authority_mps2(self._speed_mps, resistance)
        share = self._config.supervision.service_brake_share
        return share * (lowest + resistance) - resistance
