"""One measured line, and how a pair of callables is timed fairly: in turns, in the same seconds."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import NamedTuple


class Row(NamedTuple):
    """`ours` and `peer` in `unit`; no peer on this machine: None, and `peer_is` says why."""

    what: str
    ours: float
    peer: float | None
    unit: str
    peer_is: str

    @property
    def ratio_text(self) -> str:
        """The ratio ours/peer; a small one as a fraction, the way a speed-up is told."""
        if not self.peer:
            return "-"
        ratio = self.ours / self.peer
        if not ratio:
            return "0"
        return f"{ratio:.3g}" if ratio > 0.1 else f"1/{1.0 / ratio:.3g}"


def in_turns_us(
    ours: Callable[[], object], peer: Callable[[], object], *, calls: int = 2000
) -> tuple[float, float]:
    """Median time per call [us] of two callables, in eleven alternating batches each."""
    for warm in (ours, peer):
        warm()
    batches: tuple[list[float], list[float]] = ([], [])
    for _ in range(11):
        for times, call in zip(batches, (ours, peer), strict=True):
            start = time.perf_counter_ns()
            for _ in range(calls):
                call()
            times.append((time.perf_counter_ns() - start) / calls / 1000)
    return median(batches[0]), median(batches[1])
