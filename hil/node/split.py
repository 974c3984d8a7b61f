"""Where the time of a node's cycles went, from its timing ring: percentiles, computed when it has ended."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hil.node.timing import RingError, TimingReader

__all__ = ["SPLIT", "execution_split"]

SPLIT = {
    "wakeup_latency": ("scheduled_ns", "woke_ns"),
    "read": ("woke_ns", "read_ns"),
    "step": ("read_ns", "stepped_ns"),
    "encode": ("stepped_ns", "encoded_ns"),
    "send": ("encoded_ns", "sent_ns"),
    "execution": ("woke_ns", "sent_ns"),
}
"""The parts of a cycle, each between two stamps of the ring. `read` includes drain, decode and E2E check."""

PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}


def execution_split(ring: Path) -> dict[str, dict[str, float]]:
    """Percentiles in us of each part of `SPLIT`, over what the ring at this path holds; empty without one.

    In lockstep there is no schedule to be late for, and no wake-up latency.
    """
    try:
        reader = TimingReader.open(ring)
    except RingError:
        return {}
    records = reader.read_new()
    parts = {name: ends for name, ends in SPLIT.items() if name != "wakeup_latency" or
             reader.header.clock == "realtime"}  # fmt: skip
    reader.close()
    if not len(records):
        return {}
    split = {}
    for name, (begin, end) in parts.items():
        values = np.percentile(records[end] - records[begin], list(PERCENTILES.values())) / 1000.0
        split[name] = dict(zip(PERCENTILES, np.round(values, 1).tolist(), strict=True))
    return split
