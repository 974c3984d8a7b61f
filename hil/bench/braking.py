"""What happens once the controller is gone, stopped by the user or dead: the plant brakes the train.

The run goes on until the train stands, so that the recording has the end of the story.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.bench.watch import Ending, View

BRAKING_LIMIT_S = 90.0
"""No train is waited for without end."""

LAST_FRAMES_S = 0.5
"""Time for the frames that say that the train stands to reach the recorder."""

BY_THE_USER = Ending("aborted", "stopped by the user")


@dataclass(frozen=True)
class Cut:
    """The controller is gone since `since_s`; `interrupts` is how often the user had asked by then."""

    ending: Ending
    since_s: float
    interrupts: int

    def over(self, view: View, *, interrupts: int) -> bool:
        """Whether the run is over: the train stands, or never will, or the user asks once more."""
        waited_s = view.time_s - self.since_s
        settled = view.standstill and waited_s > LAST_FRAMES_S
        return settled or waited_s > BRAKING_LIMIT_S or interrupts > self.interrupts
