"""The rehearsal: just before a deadline, the cycle's code runs once on a twin, so that its caches are warm.

A node of 10 ms sleeps 98 % of its time, and what it needs has been pushed out of the caches when it wakes:
the same cycle takes three times as long as in a loop without pauses. The time before the deadline would be
polled away anyway. The twin is a unit of the same kind with state of its own. It lives one cycle behind:
it gets the frames and the time that the unit got in the last cycle, and so takes the same branches on the
same values. What it sends is thrown away.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.node.inbox import CycleTiming, Inbox
from hil.node.outbox import Outbox
from hil.node.spin import AdaptiveMargin
from hil.node.unit import Unit, every_cycle

__all__ = ["REHEARSAL_SHARE", "Rehearsal", "rehearsal_of"]

REHEARSAL_SHARE = 0.08
"""Of the period at most."""
LEAST_NS = 250_000
"""Where the share leaves less there is no rehearsal: a loop of 3 ms or less keeps its caches warm itself."""

LONGEST_NS = 1_000_000
SHORTEST_NS = 50_000
LATE_PER_MILLE = 20
"""So many rehearsals may take longer than their lead: the margin of the spin comes behind it."""
PATIENCE = 20
"""So many more rehearsals that take longer than the longest lead than others, and there are no more."""


class Rehearsal:
    """Call it in the time before a deadline; `lead` says how long it takes (a high quantile).

    `runs` and `skipped` count. An exception of the twin ends rehearsals (`failure` says why), never the node.
    """

    def __init__(
        self,
        twin: Unit,
        contract: Contract,
        *,
        largest_ns: int = LONGEST_NS,
        monotonic: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.lead = AdaptiveMargin(min(SHORTEST_NS, largest_ns), largest_ns, missed_per_mille=LATE_PER_MILLE)
        self.runs = 0
        self.skipped = 0
        self.failure = ""
        self._twin = twin
        self._inbox = Inbox(contract, twin.receives)
        self._outbox = Outbox(contract, twin.nodes, twin.period_ns, every_cycle=every_cycle(twin))
        self._monotonic = monotonic
        self._now_ns = 0
        self._scheduled_ns = 0
        self._frames: Sequence[Frame] = ()
        self._fresh = False
        self._too_long = 0

    def remember(self, scheduled_ns: int, now_ns: int, frames: Sequence[Frame], timing: CycleTiming) -> None:
        """What the unit is given in this cycle: the twin gets it before the next one."""
        self._scheduled_ns = scheduled_ns
        self._now_ns = now_ns
        self._frames = frames
        self._inbox.timing = timing
        self._fresh = True

    def __call__(self) -> None:
        """Run the twin's cycle, once for each cycle that was remembered."""
        if not self._fresh or self.failure:
            return
        self._fresh = False
        began_ns = self._monotonic()
        try:
            self._cycle()
        except Exception as error:
            self.failure = f"{type(error).__name__}: {error}"
            self._frames = ()
            return
        self.runs += 1
        took_ns = self._monotonic() - began_ns
        self.lead.observe(took_ns)
        if took_ns > self.lead.largest_ns:
            self._too_long += 1
            if self._too_long > PATIENCE:
                self.failure = f"takes longer than {self.lead.largest_ns / 1000:g} us"
        elif self._too_long:
            self._too_long -= 1

    def report(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "runs": self.runs,
            "skipped": self.skipped,
            "lead_ns": self.lead.now_ns,
            "failure": self.failure,
        }

    def _cycle(self) -> None:
        inbox = self._inbox
        inbox.begin(self._now_ns)
        accept = inbox.accept
        for stamp_ns, can_id, data in self._frames:
            accept(stamp_ns, can_id, data)
        self._twin.step(self._scheduled_ns, inbox, self._outbox)
        self._outbox.collect(self.runs)
        self._twin.probe()


def rehearsal_of(unit: Unit, contract: Contract) -> Rehearsal | None:
    """The rehearsal of a unit that has a twin (method `twin`), None for one that has not."""
    make: Callable[[], Unit] | None = getattr(unit, "twin", None)
    if make is None:
        return None
    largest_ns = min(LONGEST_NS, int(unit.period_ns * REHEARSAL_SHARE))
    return Rehearsal(make(), contract, largest_ns=largest_ns) if largest_ns >= LEAST_NS else None
