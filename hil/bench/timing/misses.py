"""Missed deadlines of a node, and whether a C program of higher priority saw the machine stall just then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["Miss", "Stall", "attributed", "missed_deadlines"]

EXPLAINED_SHARE = 0.5
"""A stall explains a miss if the witness saw at least this share of the time that the node lost; the rest is
work that waited, on cold caches."""


@dataclass(frozen=True)
class Stall:
    """A late wake-up of the witness on one CPU: when it should have come, when it came; monotonic ns."""

    cpu: int
    start_ns: int
    end_ns: int

    @property
    def duration_ns(self) -> int:
        """How late it came."""
        return self.end_ns - self.start_ns


@dataclass(frozen=True)
class Miss:
    """Deadlines missed between two cycles of a node; times monotonic ns.

    `lost_ns`: how much longer than usual the work of cycle `cycle` took to end, counted from its deadline.
    `stall_ns`: for how long the witness was kept from one CPU meanwhile; None: there was no witness.
    `blind_ns`: the period of the witness, which sees of a stall only what comes after its next wake-up.
    """

    node: str
    cycle: int
    missed: int
    from_ns: int
    until_ns: int
    lost_ns: int
    stall_ns: int | None = None
    blind_ns: int = 0

    @property
    def seen(self) -> bool:
        """Whether the witness saw a stall that explains it."""
        if not self.stall_ns:
            return False
        return self.stall_ns >= EXPLAINED_SHARE * (self.lost_ns - self.blind_ns)


def missed_deadlines(node: str, cycles: NDArray[np.void], period_ns: int) -> list[Miss]:
    """The misses in records of a timing ring, in order; the cycle before the first record is not known."""
    if len(cycles) < 2:
        return []
    scheduled, sent = cycles["scheduled_ns"], cycles["sent_ns"]
    usual_ns = int(np.median(sent - scheduled))
    found = []
    for row in np.flatnonzero(cycles["missed"][1:] > 0):
        missed = int(cycles["missed"][row + 1])
        # The work ended after the last of the missed releases, even if it was sent before (then the stall
        # came between sending and the end of the cycle).
        took_ns = max(int(sent[row] - scheduled[row]), missed * period_ns)
        start_ns = int(scheduled[row])
        found.append(
            Miss(
                node=node,
                cycle=int(cycles["cycle"][row]),
                missed=missed,
                from_ns=start_ns,
                until_ns=start_ns + max(took_ns, (missed + 1) * period_ns),
                lost_ns=max(0, took_ns - usual_ns),
            )
        )
    return found


def attributed(misses: Sequence[Miss], stalls: Sequence[Stall], blind_ns: int = 0) -> list[Miss]:
    """The misses, each with the stalls of one CPU that overlap it (0: none did): the longest, or all that was
    lost in several.

    The nodes may move between CPUs, so which CPU it was does not matter.
    """
    ordered = sorted(stalls, key=lambda stall: stall.end_ns)
    ends = np.array([stall.end_ns for stall in ordered], np.int64)
    longest_ns = max((stall.duration_ns for stall in ordered), default=0)
    result = []
    for miss in misses:
        begin = int(np.searchsorted(ends, miss.from_ns))
        end = int(np.searchsorted(ends, miss.until_ns + longest_ns, side="right"))
        overlapping = [s for s in ordered[begin:end] if s.start_ns <= miss.until_ns]
        longest = max((s.duration_ns for s in overlapping), default=0)
        result.append(replace(miss, stall_ns=max(longest, _lost_on_one_cpu(overlapping)), blind_ns=blind_ns))
    return result


def _lost_on_one_cpu(stalls: Sequence[Stall]) -> int:
    """Time in stalls on the CPU that had most [ns]; `stalls` in the order of their ends."""
    lost: dict[int, int] = {}
    counted_until: dict[int, int] = {}
    for stall in stalls:
        start_ns = max(stall.start_ns, counted_until.get(stall.cpu, stall.start_ns))
        lost[stall.cpu] = lost.get(stall.cpu, 0) + max(0, stall.end_ns - start_ns)
        counted_until[stall.cpu] = stall.end_ns
    return max(lost.values(), default=0)
