"""cyclictest's reports, and the witness: does it say when the machine stalled?"""

from __future__ import annotations

import os
import shutil
import signal
import time

import pytest

from hil.bench.errors import BenchError
from hil.bench.rights import processor_rights
from hil.bench.timing.cyclictest import (
    ALIGN_S,
    Cyclictest,
    Witness,
    offset_between,
    parse_report,
    parse_spikes,
    witness_period_ns,
)

needs_cyclictest = pytest.mark.skipif(
    shutil.which("cyclictest") is None, reason="cyclictest is not installed (Debian package rt-tests)"
)
SPIKES = """# /dev/cpu_dma_latency set to 0us
T: 0 (29370) P:60 I:500 C:   3988 Min:     15 Act:   33 Avg:   36 Max:    3092

T: 1 Spike:     200: TS:  26776079843
T: 0 Spike:      61: TS:  26776079000
spikes = 2
"""


def test_spikes_become_stalls_in_order_of_time():
    first, second = parse_spikes(SPIKES)
    assert (first.cpu, first.end_ns, first.duration_ns) == (0, 26_776_079_000_000, 61_000)
    assert (second.cpu, second.start_ns) == (1, 26_776_079_643_000)


def test_a_report_becomes_latencies_with_its_overflows_at_the_maximum():
    report = {"thread": {"0": {"histogram": {"20": 2, "31": 1}, "cycles": 4, "max": 150_000}}}
    assert list(parse_report(report).wakeup_latency_us) == [20, 20, 31, 150_000]


def test_the_witness_looks_often_enough_to_see_half_of_a_stall_that_makes_a_node_miss():
    for period_ns in (1_000_000, 2_000_000, 10_000_000, 100_000_000):
        assert witness_period_ns(period_ns) <= period_ns / 2


@pytest.mark.parametrize(
    ("deadlines", "expected"),
    [([200], 75), ([700, 200], 75), ([0, 100], 175), ([10, 20, 240], 130), ([240], 115)],
)
def test_the_witness_keeps_away_from_the_deadlines_of_the_nodes(deadlines, expected):
    offset = offset_between([1000 * us + 4_000_000 for us in deadlines], 250_000)
    assert offset // 1000 == expected


def found():
    fifo, lock, _ = processor_rights()
    peer = Cyclictest.find(fifo=fifo, lock_memory=lock)
    assert peer is not None
    return peer


@needs_cyclictest
def test_a_slice_of_cyclictest_has_every_cycle():
    piece = found().measure(period_ns=2_000_000, cycles=150, priority=50, cpu=None, waiting=lambda: None)
    assert len(piece.wakeup_latency_us) == pytest.approx(150, abs=2)
    assert piece.wakeup_latency_us.min() >= 0


@needs_cyclictest
def test_the_witness_says_when_it_was_held_up():
    """Stopped and continued by signals, it has to report a stall of that length at that time."""
    witness = Witness(found(), period_ns=1_000_000, priority=60, cpu=None, threshold_us=20_000)
    try:
        time.sleep(0.3)
        os.kill(witness.pid, signal.SIGSTOP)
        stopped_ns = time.monotonic_ns()
        time.sleep(0.08)
        continued_ns = time.monotonic_ns()
        os.kill(witness.pid, signal.SIGCONT)
        time.sleep(0.2)
        stalls = witness.stop()
    finally:
        witness.abandon()
    ours = [s for s in stalls if s.start_ns < continued_ns and s.end_ns > continued_ns - 1_000_000]
    assert ours, f"no stall at {continued_ns} among {stalls}"
    longest = max(ours, key=lambda stall: stall.duration_ns)
    assert longest.duration_ns >= 0.7 * (continued_ns - stopped_ns)
    assert longest.end_ns >= continued_ns - 1_000_000


@needs_cyclictest
def test_the_wake_ups_of_the_witness_lie_where_they_were_asked_to():
    """A threshold of 1 us keeps nearly every wake-up; what it was late subtracted, they are the grid."""
    witness = Witness(found(), period_ns=1_000_000, priority=60, cpu=None, threshold_us=1, offset_ns=300_000)
    try:
        time.sleep(ALIGN_S + 0.4)
        stalls = witness.stop()
    finally:
        witness.abandon()
    places = [round(stall.start_ns / 1000) % 1000 for stall in stalls]
    assert len(places) > 50
    assert sum(abs(place - 300) <= 2 for place in places) >= 0.9 * len(places)


@needs_cyclictest
def test_a_witness_that_ended_by_itself_is_no_witness():
    witness = Witness(found(), period_ns=1_000_000, priority=60, cpu=None, threshold_us=1000)
    os.kill(witness.pid, signal.SIGKILL)
    time.sleep(0.2)
    with pytest.raises(BenchError, match="witness"):
        witness.stop()
