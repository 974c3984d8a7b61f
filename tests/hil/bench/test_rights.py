"""Asking for real-time rights leaves this process as it was."""

import gc
import os
import sys

import pytest

from hil.bench.rights import fifo_granted, keeping_time, processor_rights

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's schedulers")


def test_asking_for_fifo_gives_it_back_and_says_what_a_child_would_get():
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    granted = fifo_granted(50)
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before
    assert granted == processor_rights(50)[0]


def test_a_refusal_is_no_error(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert fifo_granted(50) is False


@pytest.mark.parametrize("priority", [0, 1, 40])
def test_keeping_time_takes_what_it_gets_and_gives_everything_back(priority):
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    granted = priority > 0 and fifo_granted(priority)
    seen = []

    def look_and_fail():
        with keeping_time(priority):
            seen.append((gc.isenabled(), os.sched_getscheduler(0), os.sched_getparam(0).sched_priority))
            raise ArithmeticError

    with pytest.raises(ArithmeticError):
        look_and_fail()
    assert seen == [(False, *((os.SCHED_FIFO, priority) if granted else before))]
    assert gc.isenabled()
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before


def test_a_collector_that_was_off_stays_off():
    gc.disable()
    try:
        with keeping_time(0):
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
