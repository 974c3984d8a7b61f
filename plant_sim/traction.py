"""TCU, the traction control unit: passes the demand on to the drive, or cuts it.

Lost command or emergency brake: the converter is blocked without dead time. Tractive effort is gone within
a few `vehicle.PULSES_OFF_S`; electrodynamic braking falls with `vehicle.PROMPT_RATE_FACTOR` times the service
jerk limit, while the friction brake takes over.
"""

from __future__ import annotations

from enum import IntEnum

from hil.railway import Train
from plant_sim.command import CommandState, CommandWatch
from plant_sim.compiled import Motion

IDLE_N = 200.0
"""Below this effort the drive counts as idle: ten times the step of the signals that report it."""


class TractionState(IntEnum):
    """Numbers of the value table of TCU_Status.State."""

    OFF = 0
    READY = 1
    TRACTION = 2
    BRAKING = 3
    CUT = 4
    FAULT = 5


class TractionControl:
    """Logic of the TCU; the drive itself is in `dynamics`."""

    def __init__(self, train: Train) -> None:
        self._train = train
        self.state = TractionState.OFF
        self.demand = 0.0
        self.enabled = False

    def decide(self, command: CommandWatch, *, emergency: bool) -> None:
        """Set what the drive is to do in this cycle."""
        self.enabled = command.good and not emergency
        self.demand = command.demand if self.enabled else 0.0
        if command.state is CommandState.NEVER:
            self.state = TractionState.OFF
        elif not self.enabled:
            self.state = TractionState.CUT

    def report(self, motion: Motion) -> None:
        """Update the state from what the drive has done."""
        if self.enabled:
            if motion.drive_n > IDLE_N:
                self.state = TractionState.TRACTION
            elif motion.drive_n < -IDLE_N:
                self.state = TractionState.BRAKING
            else:
                self.state = TractionState.READY

    def available_n(self, speed_mps: float) -> float:
        """Largest tractive effort now [N]."""
        return self._train.traction_effort_n(speed_mps) if self.enabled else 0.0
