"""Periodic messages: by the owner's loop, by the kernel's broadcast manager, and their leases."""

import errno
import os
import socket
import struct

import can
import pytest
from can.interfaces.socketcan.socketcan import BcmMsgHead, build_can_frame
from hypothesis import given
from hypothesis import strategies as st

from hil.canbus import periodic
from hil.canbus.errors import BusLost
from hil.canbus.periodic import BroadcastTask, LoopTask, lease_of
from hil.canbus.transport import BusOptions, Transport

MS = 1_000_000


def loop_task(data=b"x", period_ns=10 * MS):
    sent = []
    return LoopTask(lambda can_id, content: sent.append((can_id, content)), 0x700, data, period_ns), sent


@given(st.lists(st.integers(1, 35 * MS), min_size=1, max_size=60))
def test_loop_task_keeps_its_phase_and_never_bursts(steps):
    task, sent = loop_task()
    now, times = 0, []
    for step in [0, *steps]:
        now += step
        before = len(sent)
        task.keep_alive(now)
        assert len(sent) - before <= 1
        if len(sent) > before:
            times.append(now)
    # Never two in one period of the grid that the first frame began, and none that was due is left out.
    slots = [time // (10 * MS) for time in times]
    assert slots == sorted(set(slots))
    looks = [0, *(sum(steps[: index + 1]) for index in range(len(steps)))]
    assert slots == sorted({look // (10 * MS) for look in looks})


def test_sequence_is_sent_in_turn_and_an_update_keeps_the_place():
    task, sent = loop_task([b"a", b"b", b"c"])
    for index in range(4):
        task.keep_alive(index * 10 * MS)
    task.update([b"A", b"B", b"C"])
    for index in range(4, 6):
        task.keep_alive(index * 10 * MS)
    assert [data for _, data in sent] == [b"a", b"b", b"c", b"a", b"B", b"C"]
    with pytest.raises(ValueError, match="2 frames in turn: this task has 3"):
        task.update([b"A", b"B"])
    task.stop()
    task.keep_alive(10**12)
    assert len(sent) == 6


def test_local_bus_sends_when_kept_alive_and_is_silent_otherwise(tmp_path):
    channel = f"periodic-{os.getpid()}"
    options = BusOptions("hil", channel)
    with Transport.open(options, name="a") as a, Transport.open(options, name="b") as b:
        task = a.send_periodic(0x705, b"\x05", 1000.0)
        assert b.receive(10.0).data == b"\x05"
        task.keep_alive()
        assert b.receive(0.05) is None
        assert a.sent == 1


@pytest.mark.parametrize(
    ("period_s", "lease_s", "expected"),
    [
        (0.1, None, (100 * MS, 3)),
        (0.1, 0.3, (100 * MS, 3)),
        (0.1, 0.31, (100 * MS, 4)),
        (1.0, 0.1, (1000 * MS, 1)),
    ],
)
def test_lease_is_counted_in_frames(period_s, lease_s, expected):
    assert lease_of(period_s, lease_s) == expected


@pytest.mark.parametrize("times", [(0.0, None), (-1.0, None), (float("nan"), None), (0.1, 0.0), (1e-9, None)])
def test_time_that_is_none_is_refused(times):
    with pytest.raises(ValueError, match="_s "):
        lease_of(*times)


class Manager:
    """The kernel's broadcast manager, as a socket that remembers what it was told."""

    def __init__(self):
        self.told, self.answers, self.closed, self.error = [], [], False, None

    def setblocking(self, flag):
        assert flag is False

    def connect(self, address):
        assert address == ("can0",)

    def send(self, content):
        if self.error:
            raise self.error
        self.told.append(content)

    def recv(self, size):
        if not self.answers:
            raise BlockingIOError
        return self.answers.pop(0)

    def close(self):
        self.closed = True

    def fileno(self):
        return -1 if self.closed else 5


@pytest.fixture
def manager(monkeypatch):
    if not hasattr(socket, "CAN_BCM"):
        pytest.skip("no AF_CAN in this Python")
    made = Manager()
    monkeypatch.setattr(periodic.socket, "socket", lambda *_: made)
    monkeypatch.setattr(periodic.time, "monotonic_ns", lambda: 0)
    return made


def head(content):
    """By python-can's ctypes structure of the same header."""
    size = len(bytes(BcmMsgHead()))
    read = BcmMsgHead.from_buffer_copy(content[:size])
    fields = ("opcode", "flags", "count", "ival1_tv_sec", "ival1_tv_usec", "ival2_tv_sec", "ival2_tv_usec")
    return [getattr(read, name) for name in (*fields, "can_id", "nframes")], content[size:]


def test_first_message_starts_the_timer_for_one_lease(manager):
    BroadcastTask("can0", 0x705, b"\x05", 1_500 * MS, 3)
    fields, frames = head(manager.told[0])
    assert fields == [1, 0x0001 | 0x0002 | 0x0004, 3, 1, 500_000, 0, 0, 0x705, 1]
    expected = bytearray(
        build_can_frame(can.Message(arbitration_id=0x705, is_extended_id=False, data=b"\x05"))
    )
    expected[7] = 0
    assert frames == bytes(expected)


def test_lease_is_renewed_at_half_without_touching_the_phase(manager):
    task = BroadcastTask("can0", 0x705, b"\x05", 100 * MS, 4)
    for now in range(0, 1000 * MS, 10 * MS):
        task.keep_alive(now)
    renewals = [head(content)[0] for content in manager.told[1:]]
    assert len(renewals) == 4
    assert all(fields[1:3] == [0x0001 | 0x0004, 4] for fields in renewals)


def test_lease_that_ran_out_is_started_again(manager):
    task = BroadcastTask("can0", 0x705, b"\x05", 100 * MS, 4)
    manager.answers = [struct.pack("=I", 9).ljust(56, b"\0")]
    task.keep_alive(5_000 * MS)
    task.keep_alive(5_300 * MS)
    assert [head(content)[0][1] for content in manager.told[1:]] == [0x0007, 0x0005]


def test_sequence_of_fd_frames_has_one_size_and_the_flag(manager):
    BroadcastTask("can0", 0x18, [bytes(64), b"short"], 10 * MS, 3)
    fields, frames = head(manager.told[0])
    assert fields[1] & 0x0800
    assert (fields[-1], len(frames)) == (2, 2 * 72)


def test_stopped_task_and_lost_interface(manager):
    task = BroadcastTask("can0", 0x705, b"\x05", 100 * MS, 3)
    manager.error = OSError(errno.ENODEV, os.strerror(errno.ENODEV))
    with pytest.raises(BusLost, match="can0"):
        task.keep_alive(5_000 * MS)
    task.stop()
    assert manager.closed
    task.keep_alive(9_000 * MS)
    task.update(b"y")


@pytest.mark.parametrize("count", [0, 257])
def test_number_of_frames_in_turn_is_limited(manager, count):
    with pytest.raises(ValueError, match="1 to 256"):
        BroadcastTask("can0", 0x18, [b""] * count, 10 * MS, 3)
