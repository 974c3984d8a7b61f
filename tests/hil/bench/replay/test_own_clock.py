"""A device with a clock of its own: its drift is no deviation, a frame left out or sent twice is one."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.bench.replay.comparison import compare
from hil.bench.replay.restbus import Said
from hil.bench.replay.rules import Rules

MS = 1_000_000
SPAN = (1_000 * MS, 9_000 * MS)


@pytest.fixture(scope="module")
def command(contract):
    return contract.message("ATO_Command")


def said(codec, times_ns):
    return [Said(int(time_ns), codec.can_id, bytes(codec.length)) for time_ns in times_ns]


def judged(codec, recorded_ns, replayed_ns, span=SPAN):
    (message,) = compare(
        [codec], said(codec, recorded_ns), said(codec, replayed_ns), Rules(), neighbours=2, span_ns=span
    ).messages
    return message


def grid(period_ns, offset_ns=0):
    return [offset_ns + round(k * period_ns) for k in range(1_000)]


@settings(deadline=None, max_examples=60)
@given(
    st.floats(-500, 500),
    st.integers(-4 * MS, 4 * MS),
    st.lists(st.integers(0, MS), min_size=1_000, max_size=1_000),
)
def test_drift_and_jitter_are_no_deviation(command, drift_ppm, offset_ns, jitter_ns):
    device = sorted(
        time + late
        for time, late in zip(grid(10 * MS * (1 + drift_ppm * 1e-6), offset_ns), jitter_ns, strict=True)
    )
    message = judged(command, grid(10 * MS), device)
    assert (message.missing_s, message.additional_s) == ((), ())
    (signal, *_) = message.signals
    assert 700 <= signal.frames <= 801


@settings(deadline=None, max_examples=60)
@given(st.integers(110, 880), st.floats(-50, 50))
def test_a_frame_left_out_is_missing(command, k, drift_ppm):
    device = grid(10 * MS * (1 + drift_ppm * 1e-6))
    del device[k]
    message = judged(command, grid(10 * MS), device)
    assert message.missing_s == (pytest.approx(k * 0.01, abs=0.006),)
    assert message.additional_s == ()


@settings(deadline=None, max_examples=60)
@given(st.integers(110, 880), st.integers(1, 2 * MS))
def test_a_frame_sent_twice_is_additional(command, k, apart_ns):
    device = grid(10 * MS)
    message = judged(command, grid(10 * MS), sorted([*device, device[k] + apart_ns]))
    assert len(message.additional_s) == 1
    assert message.missing_s == ()


def test_a_pause_of_the_recorded_node_is_not_laid_to_the_device(command):
    recorded = grid(10 * MS)
    del recorded[300:305]
    message = judged(command, recorded, grid(10 * MS))
    assert (message.missing_s, message.additional_s) == ((), ())


def test_what_lies_outside_the_span_is_not_judged(command):
    device = [time for time in grid(10 * MS) if not (200 * MS < time < 700 * MS or time > 9_500 * MS)]
    message = judged(command, grid(10 * MS), device)
    assert (message.missing_s, message.additional_s) == ((), ())
    assert message.signals[0].frames == 801


def test_a_device_that_falls_silent_is_missing_until_the_end(command):
    message = judged(command, grid(10 * MS), [time for time in grid(10 * MS) if time < 5_000 * MS])
    assert len(message.missing_s) == pytest.approx(400, abs=2)


@settings(deadline=None, max_examples=30)
@given(st.sets(st.integers(0, 999), min_size=1, max_size=20), st.integers(0, 64).filter(lambda n: n != 6))
def test_a_device_that_sends_another_length_deviates_where_it_is_judged(command, which, length):
    answers = said(command, grid(10 * MS))
    for k in which:
        answers[k] = answers[k]._replace(data=bytes(length))
    (message,) = compare(
        [command], said(command, grid(10 * MS)), answers, Rules(), neighbours=2, span_ns=SPAN
    ).messages
    assert message.wrong_length == sum(100 <= k <= 900 for k in which)
    assert (message.recorded, message.replayed) == (801, 801)
    assert message.deviates == bool(message.wrong_length)
