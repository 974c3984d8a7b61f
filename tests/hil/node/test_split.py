"""Where a node's time went: percentiles from its ring, against numpy on the same numbers."""

from __future__ import annotations

import numpy as np
import pytest

from hil.node import TimingRing
from hil.node.split import execution_split


def ring_of(path, rows, clock="realtime"):
    with TimingRing(path, name="u", period_ns=10**7, clock=clock, capacity=4096) as ring:
        for row in rows:
            ring.append(*row)


def test_parts_of_the_cycle_are_the_differences_of_their_stamps(tmp_path):
    rng = np.random.default_rng(3)
    parts = rng.integers(1_000, 90_000, (3000, 5))  # latency, read, step, encode, send
    stamps = 10**7 * np.arange(3000)[:, None] + np.cumsum(parts, axis=1)
    rows = [(k, k * 10**7, *(int(v) for v in stamps[k]), 0) for k in range(3000)]
    ring_of(tmp_path / "ring", rows)
    split = execution_split(tmp_path / "ring")
    for name, column in zip(("wakeup_latency", "read", "step", "encode", "send"), parts.T, strict=True):
        assert split[name]["p99"] == pytest.approx(np.percentile(column, 99) / 1000, abs=0.06)
        assert split[name]["max"] == pytest.approx(column.max() / 1000, abs=0.06)
    assert split["execution"]["p50"] == pytest.approx(np.median(parts[:, 1:].sum(axis=1)) / 1000, abs=0.06)


def test_lockstep_has_no_wake_up_latency(tmp_path):
    ring_of(tmp_path / "ring", [(0, 0, 5, 6, 7, 8, 9, 0)], clock="lockstep")
    assert "wakeup_latency" not in execution_split(tmp_path / "ring")


def test_ring_without_cycles_or_none_at_all_has_no_split(tmp_path):
    assert execution_split(tmp_path / "none") == {}
    ring_of(tmp_path / "ring", [])
    assert execution_split(tmp_path / "ring") == {}
