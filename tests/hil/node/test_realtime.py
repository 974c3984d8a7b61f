"""Real-time rights: what is refused is reported with a remedy, and nothing raises."""

from __future__ import annotations

import errno
import gc
import os

import pytest

from hil.node import realtime


class Library:
    """A C library that refuses what it is told to refuse."""

    def __init__(self, **results):
        self.results = results
        self.calls = []

    def mlockall(self, flags):
        self.calls.append(("mlockall", flags))
        return self.results.get("mlockall", 0)

    def prctl(self, option, value, *rest):
        self.calls.append(("prctl", option, value.value))
        return self.results.get("prctl", 0)


@pytest.fixture
def system(monkeypatch, tmp_path):
    """A system that grants everything and records it; the tests take back what they need."""
    granted = {"calls": []}
    library = Library()
    monkeypatch.setattr(realtime, "_c_library", lambda: library)
    monkeypatch.setattr(realtime, "_lock_limit", lambda: None)
    for name in ("sched_setscheduler", "sched_setaffinity"):
        monkeypatch.setattr(
            os, name, lambda *given, name=name: granted["calls"].append((name, given[1])), raising=False
        )
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1}, raising=False)
    granted["dma_latency"] = tmp_path / "cpu_dma_latency"
    granted["dma_latency"].touch()
    held = []
    monkeypatch.setattr(realtime, "DMA_LATENCY", granted["dma_latency"])
    monkeypatch.setattr(realtime, "_held", held)
    granted["held"] = held
    for name in ("collect", "freeze", "disable"):
        monkeypatch.setattr(gc, name, lambda name=name: granted["calls"].append((name,)))
    granted["library"] = library
    yield granted
    for handle in held:
        os.close(handle)


def refuse(number):
    def refused(*given):
        raise OSError(number, os.strerror(number))

    return refused


def test_everything_granted_is_reported_as_granted(system):
    rights = realtime.request(50, 1)
    assert rights.refused == ()
    assert all(right.granted for right in rights)
    names = [call[0] for call in system["calls"]]
    assert names == ["collect", "freeze", "disable", "sched_setaffinity", "sched_setscheduler"]
    assert ("prctl", realtime.PR_SET_TIMERSLACK, 1) in system["library"].calls


def test_memory_is_locked_with_both_flags(system):
    realtime.request(0, None)
    locks = [call for call in system["library"].calls if call[0] == "mlockall"]
    assert locks == [("mlockall", realtime.MCL_CURRENT | realtime.MCL_FUTURE)]


def test_refused_scheduling_names_the_remedy(system, monkeypatch):
    monkeypatch.setattr(os, "sched_setscheduler", refuse(errno.EPERM))
    right = realtime.request(50, None).sched_fifo
    assert (right.granted, right.state) == (False, "refused")
    assert "not permitted" in right.detail
    assert "rtprio" in right.remedy


def test_refused_memory_lock_names_the_remedy(system):
    system["library"].results["mlockall"] = -1
    right = realtime.request(0, None).memory_lock
    assert right.state == "refused"
    assert "memlock" in right.remedy


def test_memory_is_not_locked_into_a_limit_that_later_allocations_would_hit(system, monkeypatch):
    monkeypatch.setattr(realtime, "_lock_limit", lambda: 8 * 2**20)
    right = realtime.request(0, None).memory_lock
    assert right.state == "refused"
    assert "8192 KiB" in right.detail
    assert not [call for call in system["library"].calls if call[0] == "mlockall"]


def test_forbidden_cpu_is_refused_and_the_allowed_ones_are_named(system, monkeypatch):
    monkeypatch.setattr(os, "sched_setaffinity", refuse(errno.EINVAL))
    right = realtime.request(0, 7).cpu_affinity
    assert right.state == "refused"
    assert "0, 1" in right.detail


def test_cpu_isolated_at_boot_is_granted_though_it_is_not_in_the_affinity(system):
    assert realtime.request(0, 3).cpu_affinity.granted
    assert ("sched_setaffinity", {3}) in system["calls"]


@pytest.mark.parametrize("refused", [False, True])
def test_staying_off_a_cpu_never_raises(system, monkeypatch, refused):
    if refused:
        monkeypatch.setattr(os, "sched_setaffinity", refuse(errno.EPERM))
    with realtime.kept_off(1):
        calls = [call for call in system["calls"] if call[0] == "sched_setaffinity"]
        assert calls == ([] if refused else [("sched_setaffinity", {0})])
    assert refused or system["calls"][-1] == ("sched_setaffinity", {0, 1})


def test_priority_above_the_highest_is_refused(system):
    assert realtime.request(1000, None).sched_fifo.state == "refused"


def test_what_was_not_asked_for_is_neither_granted_nor_refused(system):
    rights = realtime.request(0, None, lock_memory=False)
    states = {right.name: right.state for right in rights}
    assert states["sched_fifo"] == states["memory_lock"] == states["cpu_affinity"] == "not asked for"
    assert not [call for call in system["calls"] if call[0].startswith("sched")]


def test_platform_without_these_calls_says_so(system, monkeypatch, tmp_path):
    def missing():
        raise AttributeError("not Linux")

    monkeypatch.setattr(realtime, "_c_library", missing)
    monkeypatch.delattr(os, "sched_setscheduler")
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.delattr(os, "sched_setaffinity")
    monkeypatch.setattr(realtime, "DMA_LATENCY", tmp_path / "none")
    monkeypatch.setattr(realtime.sys, "platform", "darwin")
    rights = realtime.request(50, 0)
    assert {right.name for right in rights.refused} == {
        "cpu_idle",
        "sched_fifo",
        "memory_lock",
        "timer_slack",
        "cpu_affinity",
    }
    assert all("Linux" in right.remedy for right in rights.refused)


def test_report_has_the_short_answers_and_the_reasons(system, monkeypatch):
    monkeypatch.setattr(os, "sched_setscheduler", refuse(errno.EPERM))
    report = realtime.request(50, None).as_dict()
    assert report["sched_fifo"] is False
    assert report["mlock"] is True
    assert report["rights"]["sched_fifo"]["state"] == "refused"


def test_own_limits_can_be_read():
    limit = realtime._lock_limit()
    assert limit is None or limit >= 0
    assert realtime._mapped_bytes() > 2**20


def test_deep_idle_is_forbidden_by_a_file_that_stays_open(system):
    right = realtime.request(50, None).cpu_idle
    assert right.granted
    assert system["dma_latency"].read_bytes() == bytes(4)  # int32 0: no microsecond of wake-up latency
    [handle] = system["held"]
    os.fstat(handle)  # still open: the kernel drops the request when it is closed
    realtime.request(50, None)
    assert system["held"] == [handle]


def test_deep_idle_of_another_users_machine_names_the_udev_rule_and_the_container_flag(system, monkeypatch):
    monkeypatch.setattr(os, "open", refuse(errno.EACCES))
    right = realtime.request(50, None).cpu_idle
    assert right.state == "refused"
    assert "udev" in right.remedy
    assert "--device=/dev/cpu_dma_latency" in right.remedy


def test_deep_idle_is_left_alone_without_a_priority(system):
    assert realtime.request(0, None).cpu_idle.state == "not asked for"
    assert system["dma_latency"].read_bytes() == b""


@pytest.mark.parametrize(("capabilities", "word"), [(0, "limits.d"), (1 << realtime.CAP_SYS_NICE, "cgroup")])
def test_refused_scheduling_of_a_process_with_the_capability_is_its_cgroups(
    system, monkeypatch, capabilities, word
):
    monkeypatch.setattr(os, "sched_setscheduler", refuse(errno.EPERM))
    monkeypatch.setattr(realtime, "_status_field", lambda name, base: capabilities)
    assert word in realtime.request(50, None).sched_fifo.remedy


@pytest.mark.parametrize(("share", "words"), [(0.95, "after 95 % of a CPU"), (1.0, "priority 50")])
def test_real_time_throttle_is_told_with_the_priority(system, monkeypatch, share, words):
    monkeypatch.setattr(realtime, "real_time_share", lambda: share)
    detail = realtime.request(50, None).sched_fifo.detail
    assert detail.startswith("priority 50")
    assert words in detail
    assert ("stops" in detail) == (share < 1.0)
