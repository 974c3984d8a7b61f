"""BCU, the brake control unit: shares a braking demand between motors and friction brake, holds, and saves.

Blending. The motors answer faster, so they give whatever part of the demand the friction brake does not
give already (`dynamics.drive_target_n`). The friction brake is ordered what the motors will be unable to
give when the order takes effect, `HORIZON_LAGS` time constants after its dead time: towards the end of
the motors' fade-out it is therefore there in time, and the motors make room for it.

Lost command: full service (or emergency) brake by friction alone to a stand, then the holding brake. The
emergency brake stays until the train stands and it is no longer asked for. Before the first command the
holding brake is applied.
"""

from __future__ import annotations

from enum import IntEnum

from hil.railway import Train
from plant_sim.command import CommandState, CommandWatch
from plant_sim.compiled import Motion
from plant_sim.config import CommandTable
from plant_sim.vehicle import Deviations

HORIZON_LAGS = 2.5
"""How many time constants ahead the friction brake is ordered: 92 % of a step have then arrived."""

HOLDING_SPEED_MPS = 0.5
"""The holding brake is applied below this speed only."""

RELEASED_FRACTION = 0.01
"""Below this fraction of the full service effort the friction brake counts as released."""

APPLIED_FRACTION = 0.9
"""From this fraction of its effort on, the holding brake counts as applied."""


class BrakeState(IntEnum):
    """Numbers of the value table of BCU_Status.State."""

    RELEASED = 0
    SERVICE = 1
    HOLDING = 2
    EMERGENCY = 3
    COMMAND_LOST = 4


class BrakeControl:
    """Logic of the BCU; the brake itself is in `dynamics`."""

    def __init__(self, train: Train, table: CommandTable, deviations: Deviations) -> None:
        self._train = train
        self._lost_n = (
            train.pneumatic.emergency_effort_n
            if table.lost_brake == "emergency"
            else min(train.service_brake_effort_n(), train.pneumatic.max_effort_n)
        )
        # the unit knows its own actuator, so the deviations of dead time and lag are known to it
        self._horizon_s = (
            train.pneumatic.dead_time_s * deviations.dead_time_factor
            + HORIZON_LAGS * train.pneumatic.time_constant_s * deviations.friction_time_constant_factor
        )
        self.state = BrakeState.HOLDING
        self.emergency = False
        self.effort_n = train.pneumatic.holding_effort_n
        self.prompt = True

    def decide(self, command: CommandWatch, speed_mps: float) -> None:
        """Set what the friction brake is to reach, from this cycle's command and the speed."""
        friction = self._train.pneumatic
        standing = speed_mps == 0.0
        if command.good and command.emergency_brake:
            self.emergency = True
        elif self.emergency and standing and command.good:
            self.emergency = False
        self.prompt = True
        if self.emergency:
            self.state, self.effort_n = BrakeState.EMERGENCY, friction.emergency_effort_n
        elif command.state is CommandState.NEVER:
            self.state, self.effort_n = BrakeState.HOLDING, friction.holding_effort_n
        elif command.state is CommandState.LOST:
            self.state = BrakeState.COMMAND_LOST
            self.effort_n = friction.holding_effort_n if standing else self._lost_n
        else:
            self._service(command, speed_mps)
            self.prompt = standing

    def report(self, motion: Motion) -> None:
        """Update the state from what the brakes have done."""
        if self.state is BrakeState.SERVICE and self.effort_n == 0.0:
            threshold_n = RELEASED_FRACTION * self._train.service_brake_effort_n()
            if motion.pneumatic_n < threshold_n and motion.drive_n > -threshold_n:
                self.state = BrakeState.RELEASED

    def holding_applied(self, motion: Motion) -> bool:
        """Whether the friction brake holds the train as the holding brake would."""
        wanted = self.state in (BrakeState.HOLDING, BrakeState.COMMAND_LOST) and motion.speed_mps == 0.0
        return wanted and motion.pneumatic_n >= APPLIED_FRACTION * self._train.pneumatic.holding_effort_n

    def end(self, *, standing: bool) -> None:
        """The unit is switched off: without power the brakes are applied."""
        self.emergency = not standing
        self.state = BrakeState.HOLDING if standing else BrakeState.EMERGENCY

    def blended_n(self, demand: float, speed_mps: float) -> float:
        """Friction brake effort to order for a braking demand in [-1, 0] [N]."""
        train = self._train
        brake_n = -demand * train.service_brake_effort_n(speed_mps)
        later_mps = max(0.0, abs(speed_mps) + demand * train.max_braking_mps2 * self._horizon_s)
        missing_n = brake_n - train.electrodynamic.effort_n(later_mps)
        return min(max(missing_n, 0.0), train.pneumatic.max_effort_n)

    def _service(self, command: CommandWatch, speed_mps: float) -> None:
        demand = min(0.0, command.demand)
        self.effort_n = self.blended_n(demand, speed_mps) if demand < 0.0 else 0.0
        self.state = BrakeState.SERVICE
        if command.holding_brake and abs(speed_mps) < HOLDING_SPEED_MPS:
            self.state = BrakeState.HOLDING
            self.effort_n = max(self.effort_n, self._train.pneumatic.holding_effort_n)
