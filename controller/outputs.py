"""What the unit puts on the bus: commands in every cycle, status now and then, an event on a change."""

from __future__ import annotations

from typing import NamedTuple

from controller.laws import Reference, clamp
from controller.modes import Mode
from controller.supervision import Supervision
from hil.canbus.contract import Contract
from hil.node.inbox import CycleTiming
from hil.node.outbox import Outbox


class Commands(NamedTuple):
    """One cycle's command to drives and brakes."""

    effort: float
    """Effort demand in [-1, 1]."""
    holding: bool
    emergency: bool


ERROR_CODES = {
    Supervision.NORMAL: "CLEARED",
    Supervision.WAITING_FOR_INPUTS: "COMMUNICATION",
    Supervision.OVERSPEED_WARNING: "OVERSPEED",
    Supervision.OVERSPEED_BRAKE: "OVERSPEED",
    Supervision.ODOMETRY_LOST: "ODOMETRY",
    Supervision.ODOMETRY_INVALID: "ODOMETRY",
    Supervision.PERMISSION_LOST: "PERMISSION",
    Supervision.TRACTION_LOST: "HEARTBEAT_LOST",
    Supervision.BRAKE_LOST: "HEARTBEAT_LOST",
    Supervision.DEADLINES_MISSED: "DEADLINE",
    Supervision.STOP_OVERRUN: "STOP_OVERRUN",
    Supervision.ROLL_BACK: "ROLL_BACK",
    Supervision.EMERGENCY_STOP_ORDERED: "EMERGENCY_STOP",
    Supervision.BALISE_MISSED: "ODOMETRY",
    Supervision.BUS_LOST: "COMMUNICATION",
}
"""Name in the contract's value table of `ATO_Emergency.ErrorCode` for each state."""

GENERIC_ERROR = 0x01  # CiA 301, error register (object 1001h), bit 0
COMMUNICATION_ERROR = 0x10  # bit 4
COMMUNICATION_STATES = frozenset(
    {
        Supervision.WAITING_FOR_INPUTS,
        Supervision.ODOMETRY_LOST,
        Supervision.TRACTION_LOST,
        Supervision.BRAKE_LOST,
        Supervision.BUS_LOST,
    }
)
NO_ODOMETRY_COUNTER = 15  # value NONE of ATO_Command.OdometryCounter


class Outputs:
    """Keeps every value inside its signal's range, so that no state of the train can make encoding fail."""

    def __init__(self, contract: Contract, *, law_number: int) -> None:
        self._law = law_number
        self._limits = {
            (message, signal.name): (signal.minimum * signal.si_factor, signal.maximum * signal.si_factor)
            for message in ("ATO_Status", "ATO_Position", "ATO_Timing", "ATO_Emergency")
            for signal in contract.message(message).signals
        }
        choices = {s.name: s.choices for s in contract.message("ATO_Emergency").signals}["ErrorCode"]
        codes = {str(name): code for code, name in choices.items()}
        self._codes = {state: codes[name] for state, name in ERROR_CODES.items()}
        self._reference_speed = self._limits["ATO_Status", "ReferenceSpeed"]
        self._speed_error = self._limits["ATO_Status", "SpeedError"]
        self._acceleration = self._limits["ATO_Status", "ReferenceAcceleration"]
        self._position = self._limits["ATO_Position", "ReferencePosition"]
        self._distance = self._limits["ATO_Position", "DistanceToStop"]
        self._latency_s = self._limits["ATO_Timing", "WakeupLatency"][1]
        self._execution_s = self._limits["ATO_Timing", "ExecutionTime"][1]
        self._misses = self._limits["ATO_Timing", "DeadlineMisses"][1]
        self._age_s = self._limits["ATO_Timing", "WorstSignalAge"][1]

    def put(
        self,
        outbox: Outbox,
        command: Commands,
        *,
        mode: Mode,
        supervision: Supervision,
        reference: Reference,
        speed_error_mps: float,
        distance_to_stop_m: float,
        odometry_counter: int | None,
        timing: CycleTiming,
        worst_age_ns: int,
    ) -> None:
        """Current values of all cyclic messages."""
        outbox.put(
            "ATO_Command",
            {
                "Mode": mode,
                "EffortDemand": command.effort,
                "HoldingBrake": command.holding,
                "EmergencyBrake": command.emergency,
                "OdometryCounter": NO_ODOMETRY_COUNTER if odometry_counter is None else odometry_counter,
            },
        )
        outbox.put(
            "ATO_Status",
            {
                "Law": self._law,
                "Mode": mode,
                "Supervision": supervision,
                "ReferenceSpeed": clamp(reference.speed_mps, *self._reference_speed),
                "SpeedError": clamp(speed_error_mps, *self._speed_error),
                "ReferenceAcceleration": clamp(reference.acceleration_mps2, *self._acceleration),
            },
        )
        outbox.put(
            "ATO_Position",
            {
                "ReferencePosition": clamp(reference.position_m, *self._position),
                "DistanceToStop": clamp(distance_to_stop_m, *self._distance),
            },
        )
        outbox.put(
            "ATO_Timing",
            {
                "WakeupLatency": min(timing.wakeup_latency_ns * 1e-9, self._latency_s),
                "ExecutionTime": min(timing.execution_ns * 1e-9, self._execution_s),
                "DeadlineMisses": min(timing.deadline_misses, self._misses),
                "WorstSignalAge": min(worst_age_ns * 1e-9, self._age_s),
            },
        )

    def changed(self, outbox: Outbox, state: Supervision, speed_mps: float) -> None:
        """Announce a change of the supervision state; the detail is the speed in mm/s."""
        register = 0
        if state is not Supervision.NORMAL:
            register = GENERIC_ERROR | (COMMUNICATION_ERROR if state in COMMUNICATION_STATES else 0)
        outbox.event(
            "ATO_Emergency",
            {
                "ErrorCode": self._codes[state],
                "ErrorRegister": register,
                "Detail": round(clamp(speed_mps * 1e3, *self._limits["ATO_Emergency", "Detail"])),
                "SupervisionState": state,
            },
        )

    def leave(self, outbox: Outbox, *, emergency: bool) -> None:
        """The last command of a unit that ends."""
        outbox.put(
            "ATO_Command",
            {
                "Mode": Mode.EMERGENCY if emergency else Mode.STANDBY,
                "EffortDemand": 0.0,
                "HoldingBrake": True,
                "EmergencyBrake": emergency,
                "OdometryCounter": NO_ODOMETRY_COUNTER,
            },
        )
