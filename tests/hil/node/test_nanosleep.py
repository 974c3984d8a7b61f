"""Sleeping until an absolute time, in machine code and without."""

from __future__ import annotations

import signal
import sys
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.node.nanosleep import sleeper

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's clock_nanosleep")
KINDS = [False, pytest.param(True, marks=on_linux)]
MS = 1_000_000


@pytest.fixture(params=KINDS, ids=["time.sleep", "machine code"])
def sleep_until(request):
    return sleeper(compiled=request.param)


def test_it_returns_the_monotonic_time_at_or_after_the_moment(sleep_until):
    for wait_ms in (0.3, 1.0, 5.0, 20.0):
        at = time.monotonic_ns() + round(wait_ms * MS)
        woke = sleep_until(at)
        assert at <= woke <= time.monotonic_ns()


@given(st.integers(-(10**9), 10**18))
def test_a_moment_that_has_passed_is_not_slept_for(past_ns):
    for kind in (False, True) if sys.platform == "linux" else (False,):
        sleep_until = SLEEPERS.setdefault(kind, sleeper(compiled=kind))
        before = time.monotonic_ns()
        woke = sleep_until(min(past_ns, before))
        assert before <= woke <= time.monotonic_ns()


SLEEPERS = {}


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs POSIX interval timers")
def test_a_signal_is_handled_before_the_sleep_would_have_ended(sleep_until):
    handled = []
    before = signal.signal(signal.SIGALRM, lambda *_: handled.append(time.monotonic_ns()))
    try:
        at = time.monotonic_ns() + 800 * MS
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        _sleep_on(sleep_until, at)
        now = time.monotonic_ns()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert len(handled) == 1
    assert handled[0] < at - 300 * MS
    assert now >= at


def _sleep_on(sleep_until, at):
    while sleep_until(at) < at:
        pass


def test_an_exception_of_a_handler_ends_the_sleep(sleep_until):
    if not hasattr(signal, "setitimer"):
        pytest.skip("needs POSIX interval timers")

    class Stop(Exception):
        pass

    def stop(*_):
        raise Stop

    before = signal.signal(signal.SIGALRM, stop)
    try:
        at = time.monotonic_ns() + 5_000 * MS
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(Stop):
            _sleep_on(sleep_until, at)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert time.monotonic_ns() < at


@on_linux
def test_the_system_has_the_machine_code_and_it_is_used():
    assert (
        sleeper().__qualname__ == sleeper(compiled=True).__qualname__ != sleeper(compiled=False).__qualname__
    )
