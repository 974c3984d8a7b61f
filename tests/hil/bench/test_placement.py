"""One CPU for the controller alone: which one, and who is kept off it."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from hil.bench import placement, rights
from hil.bench.errors import ScenarioError
from hil.bench.placement import Placement, may_use, place

NOWHERE = Placement()

needs_two_cpus = pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2,
    reason="needs two CPUs, and Linux",
)


@pytest.fixture
def fifo(monkeypatch):
    """Whether SCHED_FIFO is granted is what the test says; remembers what was asked for."""

    class Fifo:
        def __init__(self):
            self.granted, self.asked = True, []

        def __call__(self, priority):
            self.asked.append(priority)
            return self.granted

    fifo = Fifo()
    monkeypatch.setattr(placement, "fifo_granted", fifo)
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cpus: None, raising=False)
    return fifo


# -- which CPU --------------------------------------------------------------------------------------------


def test_controller_gets_the_last_cpu_and_the_others_the_rest(fifo):
    assert place("auto", 50, cpus=[4, 0, 2]) == Placement(4, frozenset({0, 2}))
    assert fifo.asked == [50]


@pytest.mark.parametrize("priority", [None, 0])
def test_without_a_priority_nobody_is_placed_and_no_right_is_tried(fifo, priority):
    assert place("auto", priority, cpus=[0, 1]) == NOWHERE
    assert fifo.asked == []


def test_without_the_right_to_sched_fifo_nobody_is_placed(fifo):
    fifo.granted = False
    assert place("auto", 50, cpus=[0, 1]) == NOWHERE


def test_one_cpu_is_for_all(fifo):
    assert place("auto", 50, cpus=[3]) == NOWHERE


def test_any_leaves_it_to_the_kernel(fifo):
    assert place("any", 50, cpus=[0, 1, 2, 3]) == NOWHERE


@pytest.mark.parametrize("priority", [None, 50])
def test_cpu_that_is_named_is_taken_whatever_the_rights(fifo, priority):
    fifo.granted = False
    assert place(1, priority, cpus=[0, 1, 2]) == Placement(1, frozenset({0, 2}))
    assert place(0, priority, cpus=[0]) == Placement(0, frozenset())


def test_cpu_that_is_not_usable_is_bad_input(fifo):
    with pytest.raises(ScenarioError, match=r"timing\.controller_cpu: 7 is not .* CPUs, 0, 1$") as wrong:
        place(7, 50, cpus=[0, 1])
    assert wrong.value.exit_code == 2


def test_cpu_isolated_at_boot_is_not_in_the_affinity_and_can_be_named(fifo, monkeypatch):
    given = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1}, raising=False)
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cpus: given.append(set(cpus)), raising=False)
    assert place("auto", 50) == Placement(1, frozenset({0}))
    assert place(3, 50) == Placement(3, frozenset({0, 1}))
    assert given == [{3}, {0, 1}]  # there and back


def test_cpu_that_the_kernel_refuses_is_bad_input(fifo, monkeypatch):
    def refuse(pid, cpus):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1}, raising=False)
    monkeypatch.setattr(os, "sched_setaffinity", refuse, raising=False)
    with pytest.raises(ScenarioError, match="3 is not among the usable CPUs, 0, 1"):
        place(3, 50)


def test_controller_alone_is_told_its_cpu():
    placed = Placement(3, frozenset({0, 1}))
    assert placed.arguments("controller") == ["--cpu", "3"]
    assert placed.arguments("plant_sim") == NOWHERE.arguments("controller") == []


# -- who is kept off it -----------------------------------------------------------------------------------


@pytest.fixture
def two():
    """The controller's CPU and the others, of this machine."""
    usable = sorted(os.sched_getaffinity(0))
    return Placement(usable[-1], frozenset(usable[:-1]))


@needs_two_cpus
def test_trying_a_cpu_leaves_the_affinity_as_it_was(two):
    before = os.sched_getaffinity(0)
    assert may_use(two.controller)
    assert not may_use(100_000)
    assert not may_use(-1)
    assert os.sched_getaffinity(0) == before


@needs_two_cpus
@pytest.mark.parametrize("fails", [False, True])
def test_launcher_with_its_threads_is_kept_off_meanwhile_and_back_afterwards(two, fails):
    before = os.sched_getaffinity(0)
    asked, child_sees = "import os; print(sorted(os.sched_getaffinity(0)))", ""
    with ThreadPoolExecutor(1) as pool:
        in_thread = lambda: pool.submit(os.sched_getaffinity, 0).result()  # noqa: E731
        assert in_thread() == before
        try:
            with two.launcher_kept_off():
                assert os.sched_getaffinity(0) == in_thread() == two.others
                child_sees = subprocess.check_output([sys.executable, "-c", asked], text=True)
                if fails:
                    raise InterruptedError
        except InterruptedError:
            assert fails
        assert os.sched_getaffinity(0) == in_thread() == before
    assert child_sees.strip() == str(sorted(two.others))


@needs_two_cpus
def test_process_is_kept_off_with_all_its_threads(two):
    program = """
import os, sys, threading
threading.Thread(target=sys.stdin.read, daemon=True).start()
print("ready", flush=True)
threading.Event().wait()
"""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    with subprocess.Popen([sys.executable, "-c", program], **pipes) as process:
        try:
            assert process.stdout.readline() == b"ready\n"
            two.keep_off([ended.pid, process.pid])  # the one that has ended does not matter
            threads = [int(name) for name in os.listdir(f"/proc/{process.pid}/task")]
            assert len(threads) == 2
            assert all(os.sched_getaffinity(thread) == two.others for thread in threads)
        finally:
            process.kill()


def test_nobody_is_moved_without_a_placement(monkeypatch):
    monkeypatch.setattr(os, "sched_setaffinity", lambda *given: pytest.fail("moved"), raising=False)
    NOWHERE.keep_off([os.getpid()])
    with NOWHERE.launcher_kept_off():
        assert threading.active_count() >= 1


# -- the right to SCHED_FIFO ------------------------------------------------------------------------------


@pytest.fixture
def scheduler(monkeypatch):
    """A kernel that remembers the policies it was asked for, and may refuse."""

    class Scheduler:
        def __init__(self):
            self.set, self.refuses = [], False

        def setscheduler(self, pid, policy, parameters):
            if self.refuses:
                raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
            self.set.append((policy, parameters))

    scheduler = Scheduler()
    for name, value in (
        ("SCHED_FIFO", 1),
        ("sched_param", lambda priority: priority),
        ("sched_getscheduler", lambda pid: 0),
        ("sched_getparam", lambda pid: 0),
        ("sched_setscheduler", scheduler.setscheduler),
    ):
        monkeypatch.setattr(os, name, value, raising=False)
    return scheduler


def test_right_is_tried_by_this_thread_and_given_back(scheduler):
    assert rights.fifo_granted(60)
    assert scheduler.set == [(1, 60), (0, 0)]


def test_right_that_is_refused_is_not_there(scheduler):
    scheduler.refuses = True
    assert not rights.fifo_granted(60)
    assert scheduler.set == []


def test_system_without_these_calls_has_no_such_right(monkeypatch):
    monkeypatch.delattr(os, "sched_setscheduler", raising=False)
    assert not rights.fifo_granted(60)
