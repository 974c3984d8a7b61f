"""Asking for real-time rights leaves this process as it was."""

import os
import sys

import pytest

from hil.bench.rights import fifo_granted, processor_rights

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
