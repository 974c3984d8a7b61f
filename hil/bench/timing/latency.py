"""Latencies out of stamps: the split of a cycle, the age of a signal at use, the way through the loop."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["chain_latency_us", "period_error_us", "signal_age_us", "spans_us"]

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
SPANS = {
    "drained_ns": "drain", "read_ns": "read", "decoded_ns": "decode", "stepped_ns": "step",
    "encoded_ns": "encode", "sent_ns": "send",
}  # fmt: skip
"""What has ended at each stamp of a timing ring. `read` drains the bus, decodes and checks E2E protection."""


def spans_us(cycles: NDArray[np.void]) -> dict[str, Array]:
    """The execution split: name -> (n) us, each from the stamp before it; the first from the wake-up."""
    spans: dict[str, Array] = {}
    before = cycles["woke_ns"]
    for field in cycles.dtype.names or ():
        if field in SPANS:
            spans[SPANS[field]] = (cycles[field] - before) / 1e3
            before = cycles[field]
    return spans


def period_error_us(cycles: NDArray[np.void]) -> Array:
    """Distance of two wake-ups minus that of their deadlines, (n - 1) us; a skipped cycle is no error."""
    error: Array = (np.diff(cycles["woke_ns"]) - np.diff(cycles["scheduled_ns"])) / 1e3
    return error


def signal_age_us(used_ns: Stamps, sent_ns: Stamps) -> Array:
    """How old the newest frame was at each use, us; uses before the first frame are left out."""
    if not len(sent_ns):
        return np.empty(0)
    newest = np.searchsorted(sent_ns, used_ns, side="right") - 1
    known = newest >= 0
    age: Array = (used_ns[known] - sent_ns[newest[known]]) / 1e3
    return age


def chain_latency_us(causes_ns: Stamps, effects_ns: Stamps) -> Array:
    """From each cause to the first effect after it, us; a cause without an effect is left out.

    The reaction time of a cause-effect chain: where the effect was skipped, the cause waits for the next.
    """
    first = np.searchsorted(effects_ns, causes_ns, side="right")
    known = first < len(effects_ns)
    latency: Array = (effects_ns[first[known]] - causes_ns[known]) / 1e3
    return latency
