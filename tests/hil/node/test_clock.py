"""Real-time clock: the grid, what an overrun does to it, and stamps; all with a fake clock."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.canbus.frame import Frame
from hil.node import RealTimeClock, first_deadline, next_deadline

PERIOD = 10_000_000
PHASE = 700_000

times = st.integers(0, 10**18)
periods = st.integers(1, 10**10)


def clock_at(time, **options):
    options = {"spin_ns": 200_000, **options}
    return RealTimeClock(
        PERIOD,
        PHASE,
        monotonic=time.monotonic,
        sleep_until=time.sleep_until,
        realtime=time.realtime,
        **options,
    )


@given(now=times, period=periods, phase=times)
def test_first_deadline_is_the_next_point_of_the_grid(now, period, phase):
    deadline = first_deadline(now, period, phase)
    assert now < deadline <= now + period
    assert (deadline - phase) % period == 0


@given(scheduled=times, period=periods, took=st.integers(0, 10**12))
def test_overrun_skips_whole_cycles_and_keeps_the_phase(scheduled, period, took):
    ended = scheduled + took
    deadline, skipped = next_deadline(ended, scheduled, period)
    assert deadline == scheduled + (1 + skipped) * period
    assert deadline >= ended
    # never more than needed: the release before this one had already passed, or is the one just worked on
    assert deadline - period == scheduled or deadline - period < ended


@given(st.lists(st.integers(0, 100_000_000), min_size=1, max_size=50))
def test_overruns_are_never_made_up_for_in_a_burst(durations):
    scheduled = PHASE
    starts = []
    for took in durations:
        starts.append(scheduled)
        scheduled, _ = next_deadline(scheduled + took, scheduled, PERIOD)
    gaps = [after - before for before, after in itertools.pairwise(starts)]
    assert all(gap >= PERIOD and gap % PERIOD == 0 for gap in gaps)


@pytest.mark.parametrize(
    ("took", "skipped"),
    [(0, 0), (PERIOD, 0), (PERIOD + 1, 1), (2 * PERIOD, 1), (2 * PERIOD + 1, 2), (5 * PERIOD + 1, 5)],
)
def test_work_that_ends_after_the_next_release_misses_it(took, skipped):
    assert next_deadline(PHASE + took, PHASE, PERIOD) == (PHASE + (skipped + 1) * PERIOD, skipped)


def test_deadlines_lie_on_the_absolute_grid(fakes):
    time = fakes.Time(now_ns=123_456_789)
    clock = clock_at(time)
    starts = []
    for _ in range(5):
        start = clock.wait()
        starts.append(start.scheduled_ns)
        time.now_ns += 3_000_000
        assert clock.finished(time.now_ns) == 0
    assert starts == [130_700_000 + k * PERIOD for k in range(5)]


def test_sleeps_to_the_spin_and_polls_the_rest(fakes):
    time = fakes.Time()
    clock = clock_at(time)
    start = clock.wait()
    assert len(time.sleeps) == 1
    # woken by the spin, one look of the fake clock after the deadline at the latest
    assert 0 <= start.woke_ns - start.scheduled_ns <= time.step_ns


def test_without_spin_the_sleep_ends_on_the_deadline(fakes):
    time = fakes.Time()
    clock = clock_at(time, spin_ns=0)
    start = clock.wait()
    assert start.woke_ns >= start.scheduled_ns
    assert len(time.sleeps) == 1


def test_sleep_that_ends_early_is_continued(fakes):
    time = fakes.Time()
    sleep_until = time.sleep_until
    time.sleep_until = lambda at_ns: sleep_until(time.now_ns + (at_ns - time.now_ns) * 6 // 10)
    start = clock_at(time).wait()
    assert len(time.sleeps) > 1
    assert start.woke_ns >= start.scheduled_ns


def test_late_wake_up_is_reported_as_latency(fakes):
    time = fakes.Time()
    time.oversleep_ns = 1_000_000
    start = clock_at(time, spin_ns=200_000).wait()
    assert start.woke_ns - start.scheduled_ns == pytest.approx(800_000, abs=1_000)


def test_skipped_cycles_are_reported_with_the_next_start(fakes):
    time = fakes.Time()
    clock = clock_at(time)
    first = clock.wait()
    assert clock.finished(first.scheduled_ns + 35_000_000) == 3
    time.now_ns = first.scheduled_ns + 35_000_000
    second = clock.wait()
    assert (second.scheduled_ns, second.skipped) == (first.scheduled_ns + 4 * PERIOD, 3)
    assert clock.finished(second.scheduled_ns + 1_000) == 0
    assert clock.wait().skipped == 0


def test_stop_request_ends_the_wait(fakes):
    assert clock_at(fakes.Time()).wait(lambda: True) is None


def test_stamps_are_converted_to_the_monotonic_domain(fakes):
    time, transport = fakes.Time(), fakes.Transport()
    clock = clock_at(time, transport=transport)
    clock.wait()
    transport.waiting.append(Frame(time.realtime() - 4_000_000, 0x184, b"x"))
    sent = time.now_ns - 4_000_000
    [frame] = clock.frames()
    assert frame.timestamp_ns == pytest.approx(sent, abs=1_000)
    assert (frame.can_id, frame.data) == (0x184, b"x")


@pytest.mark.parametrize("stamp", [0, 5_000_000_000, 2 * 10**18])
def test_stamp_that_is_not_of_this_hosts_clock_becomes_the_time_of_arrival(fakes, stamp):
    time, transport = fakes.Time(), fakes.Transport()
    clock = clock_at(time, transport=transport)
    clock.wait()
    transport.waiting.append(Frame(stamp, 0x184, b"x"))
    before = time.now_ns
    [frame] = clock.frames()
    assert before <= frame.timestamp_ns <= time.now_ns


def test_step_of_the_wall_clock_is_followed_and_counted(fakes):
    time, transport = fakes.Time(), fakes.Transport()
    clock = clock_at(time, transport=transport)
    clock.wait()
    clock.frames()
    time.realtime_offset_ns += 3_600_000_000_000
    transport.waiting.append(Frame(time.realtime() - 2_000_000, 0x184, b"x"))
    sent = time.now_ns - 2_000_000
    [frame] = clock.frames()
    assert frame.timestamp_ns == pytest.approx(sent, abs=2_000)
    assert clock.realtime_steps == 1


@pytest.mark.parametrize(("period", "spin"), [(0, 0), (-1, 0), (1000, -1), (1000, 1001)])
def test_impossible_periods_and_spins_are_refused(period, spin):
    with pytest.raises(ValueError, match="must be"):
        RealTimeClock(period, 0, spin)
