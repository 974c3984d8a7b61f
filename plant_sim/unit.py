"""The plant as a unit on the bus: plays TCU, BCU, ODO and ATP around one train.

One cycle: ATO_Command -> control units -> train over one period -> sensors -> messages. What is sent in
a cycle is the state at its end. Cycles that were skipped are made up for in the next one, so the train
keeps the time of the clock.
"""

from __future__ import annotations

from pathlib import Path

from hil.canbus.contract import Contract, ContractError
from hil.node import Inbox, Outbox, Probe
from hil.node.outbox import check_period
from hil.railway import Journey, RailwayDataError, load_journey
from plant_sim.atp import Protection
from plant_sim.brakes import BrakeControl
from plant_sim.command import CommandState, CommandWatch
from plant_sim.compiled import KernelDynamics, Motion
from plant_sim.config import PlantConfig
from plant_sim.dynamics import Orders
from plant_sim.odometry import Odometry
from plant_sim.traction import TractionControl, TractionState
from plant_sim.vehicle import Deviations, Disturbance, Vehicle

PROBES = (
    Probe("position_m", "m"),
    Probe("speed_mps", "m/s"),
    Probe("acceleration_mps2", "m/s^2"),
    Probe("traction_effort_n", "N"),
    Probe("electrodynamic_effort_n", "N"),
    Probe("pneumatic_effort_n", "N"),
    Probe("resistance_n", "N"),
    Probe("permitted_speed_mps", "m/s"),
    Probe("traction_energy_j", "J"),
    Probe("regenerated_energy_j", "J"),
    Probe("odometry_error_m", "m"),
    Probe("command_age_ms", "ms"),
)

LONGEST_CATCH_UP = 100
"""Cycles made up for at most; a longer gap is a suspended process, not a late one."""

WARM_UP_CYCLES = 20

# EMCY, CiA 301: error codes and error register (bit 0 generic, bit 4 communication).
ERROR_CLEARED, ERROR_COMMAND_LOST, ERROR_EMERGENCY_STOP = 0x0000, 0x8120, 0xFF07
REGISTER_GENERIC, REGISTER_COMMUNICATION = 0x01, 0x11
SUPERVISION_NORMAL, SUPERVISION_EMERGENCY_STOP, SUPERVISION_BUS_LOST = 0, 12, 14

MAX_AGE_MS = 255
CYCLIC = ("TCU_Status", "BCU_Status", "ODO_Motion", "ATP_Permission")
MAX_TARGET_DISTANCE_M = 100_000.0


def build(scenario: Path, contract: Contract) -> PlantUnit:
    """The plant of a scenario file; RailwayDataError or ContractError say what is wrong in one line."""
    config = PlantConfig.load(scenario)
    try:
        check_period(contract, PlantUnit.nodes, config.period_ns)
    except ContractError as error:
        raise RailwayDataError(f"{scenario}: plant.period_s: {error}") from None
    return PlantUnit(load_journey(scenario), config, contract)


class PlantUnit:
    """Train, drives, brakes, odometer and protection of one journey; see `hil.node.Unit`."""

    name = "plant_sim"
    nodes = ("TCU", "BCU", "ODO", "ATP")
    receives = ("ATO_Command",)
    after = ("ATO_SyncDone",)
    probes = PROBES

    def __init__(self, journey: Journey, config: PlantConfig, contract: Contract) -> None:
        contract.require(
            [*self.receives, *CYCLIC, "ODO_Balise", "ATP_Restriction", "TCU_Emergency", "BCU_Emergency"]
        )  # fmt: skip
        self._contract = contract
        self._codecs = {name: contract.message(name) for name in CYCLIC}
        self.journey = journey
        self.config = config
        self.period_ns = config.period_ns
        train = journey.train
        deviations = Deviations(**config.train.model_dump())
        disturbance = Disturbance(**config.disturbance.model_dump())
        self.vehicle = Vehicle(train, journey.line, deviations, config.point_mass, disturbance)
        start_m = journey.origin.position_m
        self._dynamics = KernelDynamics(
            self.vehicle, start_m, config.substep_s, train.pneumatic.holding_effort_n
        )
        self._command = CommandWatch(config.command)
        self._traction = TractionControl(train)
        self._brakes = BrakeControl(train, config.command, deviations)
        self._odometry = Odometry(config.odometry, journey.line.balises, start_m, journey.seed)
        self._protection = Protection(journey, config.atp, self.vehicle.length_m)
        # the units report nominal efforts: they do not know what share of them arrives
        self._believed = (1.0 / deviations.traction_factor, 1.0 / deviations.brake_factor)
        self._believed_friction = self._believed[1] / deviations.friction_brake_factor
        self._started_ns: int | None = None
        self._cycles = 0
        self._lost_before = False
        self.motion: Motion = self._dynamics.motion

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """One cycle; see the module."""
        motion = self.motion
        command = self._command
        had_emergency = self._brakes.emergency
        changed = command.update(inbox["ATO_Command"], standstill=motion.speed_mps == 0.0)
        self._brakes.decide(command, motion.speed_mps)
        self._traction.decide(command, emergency=self._brakes.emergency)
        orders = Orders(
            self._traction.demand, self._traction.enabled, self._brakes.effort_n, self._brakes.prompt
        )
        cycles = self._due_cycles(now_ns)
        motion = self.motion = self._dynamics.advance(orders, cycles * self.config.substeps)
        self._traction.report(motion)
        self._brakes.report(motion)
        self._odometry.update(
            motion.position_m, motion.speed_mps, cycles * self.config.period_s,
            slips=motion.slips > 0.0, slides=motion.slides > 0.0,
        )  # fmt: skip
        time_s = self._cycles * self.config.period_s
        mode = command.mode if command.good else 0
        self._protection.update(time_s, motion.position_m, motion.speed_mps, mode)
        self._put(outbox)
        if changed is not None and changed is not CommandState.NEVER:
            self._report_command(outbox, changed)
        if self._brakes.emergency is not had_emergency:
            self._report_emergency(outbox)
        for balise in self._odometry.passed:
            outbox.event("ODO_Balise", {"Number": balise.number, "Position": balise.position_m})
        for told in self._protection.announcements:
            outbox.event("ATP_Restriction", told)

    def probe(self) -> tuple[float, ...]:
        """Ground truth after the step, in the order of `probes`."""
        motion = self.motion
        return (
            motion.position_m,
            motion.speed_mps,
            motion.acceleration_mps2,
            motion.traction_effort_n,
            motion.electrodynamic_effort_n,
            motion.pneumatic_effort_n,
            motion.resistance_n,
            self._protection.permitted_speed_mps,
            motion.traction_work_j,
            motion.electrodynamic_work_j,
            self._odometry.error_m,
            self._command.age_ns * 1e-6,
        )

    def stop(self, outbox: Outbox) -> None:
        """Traction off, brakes applied, nothing authorised: what the units say when the node ends."""
        self._traction.enabled = False
        self._traction.state = TractionState.OFF
        standing = self.motion.speed_mps == 0.0
        self._brakes.end(standing=standing)
        self._protection.departure_authorised = False
        self._protection.emergency_stop = not standing
        self._put(outbox, ended=True)

    def warm_up(self) -> None:
        """Compile or load the kernel, and let a twin of this unit run some cycles."""
        self._dynamics.warm_up()
        twin = self.twin()
        inbox = Inbox(self._contract, twin.receives)
        outbox = Outbox(self._contract, twin.nodes, twin.period_ns)
        for cycle in range(WARM_UP_CYCLES):
            inbox.begin(cycle * twin.period_ns)
            twin.step(cycle * twin.period_ns, inbox, outbox)
            twin.probe()
            outbox.collect(cycle)

    def twin(self) -> PlantUnit:
        """Another plant of the same journey, as it was at the start."""
        return PlantUnit(self.journey, self.config, self._contract)

    def _due_cycles(self, now_ns: int) -> int:
        """Cycles to integrate so that the train's time follows the clock: 1, or more after a skip."""
        if self._started_ns is None:
            self._started_ns = now_ns
        number = (now_ns - self._started_ns + self.period_ns // 2) // self.period_ns
        due = max(1, number + 1 - self._cycles)
        if due > LONGEST_CATCH_UP:
            self._started_ns += (due - LONGEST_CATCH_UP) * self.period_ns
            due = LONGEST_CATCH_UP
        self._cycles += due
        return due

    def _put(self, outbox: Outbox, *, ended: bool = False) -> None:
        motion, traction, brakes, odometry = self.motion, self._traction, self._brakes, self._odometry
        protection, command = self._protection, self._command
        traction_n = 0.0 if ended else motion.traction_effort_n * self._believed[0]
        motors_n = 0.0 if ended else motion.electrodynamic_effort_n * self._believed[1]
        status = int(command.status)
        self._send(outbox, "TCU_Status", {
            "State": traction.state,
            "TractiveEffort": traction_n - motors_n,
            "EffortAvailable": traction.available_n(abs(motion.speed_mps)),
            "CommandStatus": status,
            "CommandAge": 1e-3 * min(MAX_AGE_MS, command.age_ns // 1_000_000),
        })  # fmt: skip
        self._send(outbox, "BCU_Status", {
            "State": brakes.state,
            "ElectrodynamicEffort": motors_n,
            "PneumaticEffort": motion.pneumatic_effort_n * self._believed_friction,
            "CommandStatus": status,
            "HoldingApplied": brakes.holding_applied(motion),
            "EmergencyApplied": brakes.emergency,
        })  # fmt: skip
        self._send(outbox, "ODO_Motion", {
            "Valid": not ended,
            "Standstill": odometry.standstill,
            "Slip": odometry.slip,
            "Slide": odometry.slide,
            "Speed": odometry.speed_mps,
            "Position": odometry.position_m,
        })  # fmt: skip
        self._send(outbox, "ATP_Permission", {
            "DoorsClosed": protection.doors_closed,
            "DepartureAuthorised": protection.departure_authorised,
            "EmergencyStop": protection.emergency_stop,
            "PermittedSpeed": protection.permitted_speed_mps,
            "TargetSpeed": protection.target_speed_mps,
            "TargetDistance": min(protection.target_distance_m, MAX_TARGET_DISTANCE_M),
        })  # fmt: skip

    def _send(self, outbox: Outbox, name: str, values: dict[str, float]) -> None:
        """Put a message; a value beyond its signal's range goes out as the limit, as a real unit's would."""
        outbox.put(name, self._codecs[name].saturated(values))

    def _report_command(self, outbox: Outbox, state: CommandState) -> None:
        """EMCY of TCU and BCU: the command is lost, or good again; Detail is its age in ms."""
        if state is CommandState.LOST:
            code, register, supervision = ERROR_COMMAND_LOST, REGISTER_COMMUNICATION, SUPERVISION_BUS_LOST
        elif self._lost_before:
            code, register, supervision = ERROR_CLEARED, 0, SUPERVISION_NORMAL
        else:
            return
        self._lost_before = state is CommandState.LOST
        age_ms = self._command.age_ns // 1_000_000
        for node in ("TCU", "BCU"):
            outbox.event(f"{node}_Emergency", _emergency(code, register, age_ms, supervision))

    def _report_emergency(self, outbox: Outbox) -> None:
        """EMCY of the BCU: emergency brake applied or released; Detail is the speed in mm/s."""
        speed_mmps = round(1000.0 * self.motion.speed_mps)
        if self._brakes.emergency:
            values = _emergency(
                ERROR_EMERGENCY_STOP, REGISTER_GENERIC, speed_mmps, SUPERVISION_EMERGENCY_STOP
            )
        else:
            values = _emergency(ERROR_CLEARED, 0, speed_mmps, SUPERVISION_NORMAL)
        outbox.event("BCU_Emergency", values)


def _emergency(code: int, register: int, detail: int, supervision: int) -> dict[str, float]:
    return {"ErrorCode": code, "ErrorRegister": register, "Detail": detail, "SupervisionState": supervision}
