"""What happens once the controller is gone, stopped by the user or dead: the plant brakes the train.

The run goes on until the train stands, so that the recording has the end of the story.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.bench.watch import Ending, View

BRAKING_LIMIT_S = 90.0
"""No train is waited for without end."""

SETTLE_S = 0.5
"""The odometer says "standstill" while the train still creeps; so long it must have said so, and so long
the frames that say it have to reach the recorder."""

BY_THE_USER = Ending("aborted", "stopped by the user")


@dataclass
class Cut:
    """The controller is gone since `since_s`; `interrupts` is how often the user had asked by then."""

    ending: Ending
    since_s: float
    interrupts: int
    _standing_since_s: float | None = None

    def over(self, view: View, *, interrupts: int) -> bool:
        """Whether the run is over: the train stands, or never will, or the user asks once more."""
        if not view.standstill:
            self._standing_since_s = None
        elif self._standing_since_s is None:
            self._standing_since_s = view.time_s
        settled = self._standing_since_s is not None and view.time_s - self._standing_since_s > SETTLE_S
        gave_up = view.time_s - self.since_s > BRAKING_LIMIT_S
        return settled or gave_up or interrupts > self.interrupts
