"""Supervision of ATO_Command by the units that obey it: good, lost, or never there.

A command is lost when it is silent past its limit in the DBC, or when so many frames in a row are
rejected that the receiver calls it faulty. It is trusted again after `recovery_commands` accepted
commands in a row without a rejected one between them; with `recovery = "standstill"` the train must
also have come to a stand.
"""

from __future__ import annotations

from enum import Enum

from hil.canbus.protection import E2EStatus
from hil.node import Received
from plant_sim.config import CommandTable


class CommandState(Enum):
    """Whether the units obey the command."""

    NEVER = "never"
    """None was accepted since the start."""
    GOOD = "good"
    LOST = "lost"


class CommandWatch:
    """The last accepted command and whether it counts."""

    def __init__(self, table: CommandTable) -> None:
        self._needed = table.recovery_commands
        self._standstill_needed = table.recovery == "standstill"
        self._ok = 0
        self._rejected = 0
        self._in_a_row = 0
        self.state = CommandState.NEVER
        self.status = E2EStatus.NO_NEW_DATA
        self.age_ns = 0
        self.mode = 0
        self.demand = 0.0
        self.holding_brake = True
        self.emergency_brake = False

    @property
    def good(self) -> bool:
        """Whether the command is to be obeyed."""
        return self.state is CommandState.GOOD

    def update(self, received: Received, *, standstill: bool) -> CommandState | None:
        """Take one cycle's input; the new state if it has changed."""
        timed_out = received.timed_out()
        if timed_out or received.rejected > self._rejected:
            self._in_a_row = 0
        if not timed_out:
            self._in_a_row += received.ok - self._ok
        self._ok, self._rejected = received.ok, received.rejected
        self.age_ns = received.age_ns()
        if received.status is not E2EStatus.NO_NEW_DATA or timed_out:
            self.status = received.status
        state = self._next(received.valid, standstill)
        if state is CommandState.GOOD and received.received:
            values = received.values
            self.mode = int(values["Mode"])
            self.demand = min(1.0, max(-1.0, values["EffortDemand"]))
            self.holding_brake = bool(values["HoldingBrake"])
            self.emergency_brake = bool(values["EmergencyBrake"])
        changed = state is not self.state
        self.state = state
        return state if changed else None

    def _next(self, valid: bool, standstill: bool) -> CommandState:
        if self.state is CommandState.NEVER:
            return CommandState.GOOD if valid else CommandState.NEVER
        if not valid:
            return CommandState.LOST
        if self.state is CommandState.LOST and (
            self._in_a_row < self._needed or (self._standstill_needed and not standstill)
        ):
            return CommandState.LOST
        return CommandState.GOOD
