"""When the node's cycles were in a real-time recording: from its timing ring, else from its own frames.

A real-time node reads what has arrived when it wakes. To give it the same frames in the same cycles, replay
has to know when each cycle woke; the ring says so to the microsecond, a frame log only by the stamps of what
the node sent.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["Cycles", "cycles_of_frames", "cycles_of_recording"]

Stamps = NDArray[np.int64]
NS_PER_US = 1e3
EARLIEST = 0.01
"""Quantile of a node's delays that stands for the shortest: a stamp or two may be wrong."""

MARGIN = 10
"""A frame may come sooner than the phase by this part of the period."""

BLOCK = 2000
"""Cycles over which the phase is taken to stand still."""


@dataclass(frozen=True)
class Cycles:
    """n cycles of a node in epoch ns: `scheduled_ns`, `woke_ns`, `drained_ns` (all (n), ascending).

    `drained_ns`: what had arrived until then was read. `skipped` (n): whole cycles left out just before.
    `exact`: measured by the node itself, not taken from its frames.
    """

    scheduled_ns: Stamps
    woke_ns: Stamps
    drained_ns: Stamps
    skipped: Stamps
    source: str
    exact: bool = True

    def __len__(self) -> int:
        return len(self.scheduled_ns)

    def cycle_of(self, stamps_ns: Stamps) -> Stamps:
        """In which cycle something was sent; -1 before the first."""
        return np.searchsorted(self.woke_ns, stamps_ns, side="right") - 1


def cycles_of_recording(recording: Path, process: str, period_ns: int) -> Cycles | None:
    """The cycles in run.rrd; None if they are not there, or not all from the first one on."""
    from hil.record.run_data import open_run

    run = open_run(recording)
    if process not in run.processes:
        return None
    timing = run.timing(process)
    scheduled = np.asarray(run[f"{process}.wakeup_latency_us"].bus_time_ns, dtype=np.int64)
    skipped = np.diff(timing["missed"], prepend=0.0).astype(np.int64)
    # A cycle that the recorder was too slow for would be missing from the grid.
    elapsed = np.rint(np.diff(scheduled) / period_ns).astype(np.int64)
    if not len(scheduled) or np.any(elapsed != 1 + skipped[1:]):
        return None
    woke = scheduled + np.rint(timing["wakeup_latency_us"] * NS_PER_US).astype(np.int64)
    # `read` is fetching, then decoding, which takes about as long every time: a long one is late to fetch.
    read = np.rint(timing["read_us"] * NS_PER_US).astype(np.int64)
    drained = woke + read - np.minimum(read, int(np.median(read))) // 2
    return Cycles(scheduled, woke, drained, skipped, f"timing ring in {recording.name}")


def cycles_of_frames(
    stamps_ns: Stamps, can_ids: Stamps, period_ns: int, *, every_cycle: bool, repeats: frozenset[int]
) -> Cycles:
    """The cycles in which a node sent frames at these times (m, ascending, m > 0) with these identifiers.

    A node sends the frames of one cycle by ascending identifier, so a cycle begins where the identifier does
    not grow; one of `repeats` may come several times. Its deadlines lie on a grid of `period_ns`, of which
    the frames that came soonest show the phase. `every_cycle`: the node sends something in each of its
    cycles, so one without frames was skipped; else such a cycle is taken to have run.
    """
    again = (can_ids[1:] == can_ids[:-1]) & ~np.isin(can_ids[1:], list(repeats))
    begins = (can_ids[1:] < can_ids[:-1]) | again | (np.diff(stamps_ns) > period_ns // 2)
    sent = stamps_ns[np.concatenate([[True], begins])]
    phases = _phases(sent, period_ns)
    index = (sent - phases + period_ns // MARGIN) // period_ns
    # Two cycles have two deadlines, however late the first was.
    order = np.arange(len(index))
    index = np.maximum.accumulate(index - order) + order
    delay = int(np.median(sent - index * period_ns - phases))
    if every_cycle:
        # A node that is late goes on with the first deadline after its end: those it skips are skipped after
        # the late cycle, not before it.
        index = np.concatenate([index[:1], index[:-1] + 1])
    scheduled = index * period_ns + phases
    woke = np.maximum.accumulate(np.minimum(np.maximum(scheduled, sent - delay), sent))
    skipped = np.diff(index, prepend=index[0] - 1) - 1
    if not every_cycle and skipped.any():
        scheduled, woke = _filled(index, scheduled, woke, period_ns)
        skipped = np.zeros(len(scheduled), dtype=np.int64)
    return Cycles(scheduled, woke, woke, skipped, "stamps of the node's own frames", exact=False)


def _filled(index: Stamps, scheduled: Stamps, woke: Stamps, period_ns: int) -> tuple[Stamps, Stamps]:
    """The same cycles and the silent ones between them."""
    every = np.arange(index[0], index[-1] + 1)
    known = np.clip(np.searchsorted(index, every, side="right") - 1, 0, None)
    grid = scheduled[known] + (every - index[known]) * period_ns
    return grid, np.where(index[known] == every, woke[known], grid)


def _phases(stamps_ns: Stamps, period_ns: int) -> Stamps:
    """Phase of the grid after whose points the stamps come soonest, ns, for each stamp (n).

    Found block by block: the node's clock and the one that stamped the frames may drift apart.
    """
    phases = np.empty(len(stamps_ns), dtype=np.int64)
    before: int | None = None
    for begin in range(0, len(stamps_ns), BLOCK):
        phase = _earliest_phase(stamps_ns[begin : begin + BLOCK], period_ns)
        if before is not None:  # the same grid, however far it has moved
            phase += round((before - phase) / period_ns) * period_ns
        phases[begin : begin + BLOCK] = before = phase
    return phases


def _earliest_phase(stamps_ns: Stamps, period_ns: int) -> int:
    """Phase of the grid of one block of stamps."""
    turns = (stamps_ns % period_ns) / period_ns * 2.0 * np.pi
    middle = round(float(np.angle(np.mean(np.exp(1j * turns)))) / (2.0 * np.pi) * period_ns)
    around = (stamps_ns - middle + period_ns // 2) % period_ns - period_ns // 2
    return middle + int(np.quantile(around, EARLIEST, method="lower"))
