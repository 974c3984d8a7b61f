"""Cycles found from the stamps of frames: as many as there were, each where it was."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.bench.replay.cycles import cycles_of_frames

PERIOD = 10_000_000
START = 1_700_000_000_000_000_000


def frames_of(index, delays, phase):
    """Two frames a cycle, 0x181 then 0x281, some time after their deadline."""
    deadlines = START + phase + np.asarray(index, dtype=np.int64) * PERIOD
    first = deadlines + delays
    stamps = np.column_stack([first, first + 30_000]).ravel()
    return deadlines, stamps, np.tile([0x181, 0x281], len(index))


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, PERIOD - 1),
    st.lists(st.integers(200_000, 900_000), min_size=5, max_size=60),
    st.integers(0, 3),
)
def test_every_cycle_is_found_on_its_grid(phase, delays, skips):
    index = np.arange(len(delays))
    index[len(delays) // 2 :] += skips
    _, stamps, ids = frames_of(index, delays, phase)
    found = cycles_of_frames(stamps, ids, PERIOD, every_cycle=True, repeats=frozenset())
    assert len(found) == len(delays)
    assert int(found.skipped.sum()) in (skips, 0)  # a skip at the very end is not seen
    assert np.all(np.diff(found.scheduled_ns) > 0)
    assert np.all(found.woke_ns >= found.scheduled_ns)
    assert np.all(found.woke_ns <= stamps[::2])
    assert np.all(found.cycle_of(stamps[::2]) == np.arange(len(delays)))


def test_the_deadlines_that_a_late_cycle_missed_are_skipped_after_it():
    index = [0, 1, 2, 3, 8, 9, 10]  # the cycle of deadline 3 ended 41 ms late, in the slot of 7
    delays = np.array([300_000, 300_000, 300_000, 41_000_000, 300_000, 300_000, 300_000])
    deadlines, stamps, ids = frames_of(index, delays, 0)
    found = cycles_of_frames(stamps, ids, PERIOD, every_cycle=True, repeats=frozenset())
    assert found.skipped.tolist() == [0, 0, 0, 0, 4, 0, 0]
    assert np.max(np.abs(found.scheduled_ns - deadlines - 300_000)) == 0


def test_a_node_that_is_silent_in_some_cycles_runs_them_all():
    _, stamps, ids = frames_of(np.arange(0, 50, 5), np.full(10, 300_000), 0)
    found = cycles_of_frames(stamps, ids, PERIOD, every_cycle=False, repeats=frozenset())
    assert len(found) == 46
    assert not found.skipped.any()
    assert np.all(np.diff(found.scheduled_ns) == PERIOD)


def test_two_events_in_one_cycle_are_no_two_cycles():
    _, stamps, ids = frames_of(np.arange(4), np.full(4, 300_000), 0)
    at = 3
    stamps, ids = np.insert(stamps, at, stamps[at - 1] + 1000), np.insert(ids, at, 0x181)
    twice = cycles_of_frames(stamps, ids, PERIOD, every_cycle=True, repeats=frozenset())
    assert len(twice) == 5
    events = cycles_of_frames(stamps, ids, PERIOD, every_cycle=True, repeats=frozenset({0x181}))
    assert len(events) == 4


def test_a_clock_that_drifts_is_followed():
    count = 20_000  # 200 s
    _, stamps, ids = frames_of(np.arange(count), np.full(count, 300_000), 0)
    drifting = START + ((stamps - START) * 1.00008).astype(np.int64)  # 80 ppm: 16 ms
    found = cycles_of_frames(drifting, ids, PERIOD, every_cycle=True, repeats=frozenset())
    assert len(found) == count
    assert not found.skipped.any()
