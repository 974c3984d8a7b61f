"""SocketCAN's port over a pair of ordinary sockets instead of a CAN socket: reading, bus-off, errors."""

import errno
import os
import socket
import sys

import pytest

from hil.canbus import socketcan
from hil.canbus.error_frames import ERROR_FLAG, State
from hil.canbus.errors import BusLost, BusOptionsError, BusUnavailable, TransmitQueueFull
from hil.canbus.frame import EXTENDED_ID_FLAG
from hil.canbus.socketcan import SocketCanPort
from hil.canbus.socketcan_socket import SocketOptions, options_from
from hil.canbus.socketcan_wire import REMOTE_FLAG, SO_TIMESTAMPNS, pack_frame
from hil.canbus.transport import BusOptions, Transport

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="recvmmsg is Linux's")


class Clock:
    def __init__(self):
        self.now_ns = 1_000_000_000

    def monotonic_ns(self):
        return self.now_ns

    def monotonic(self):
        return self.now_ns * 1e-9

    def sleep(self, seconds):
        self.now_ns += round(seconds * 1e9)


class Wire:
    """The other end of the port's socket."""

    def __init__(self, monkeypatch):
        self.port_end, self.end = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        for sock in (self.port_end, self.end):
            sock.setblocking(False)
        self.port_end.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.clock = Clock()
        self.off = False
        monkeypatch.setattr(socketcan, "open_socket", lambda *_, **__: (self.port_end, 0))
        monkeypatch.setattr(socketcan, "is_off", lambda _: self.off)
        monkeypatch.setattr(socketcan, "time", self.clock)

    def port(self, wanted=None, *, fd=False, **extra):
        return SocketCanPort("can0", wanted, fd=fd, extra=extra)

    def transport(self, **extra):
        return Transport(self.port(**extra), BusOptions("socketcan", "can0"))

    def frame(self, can_id, data=b""):
        self.end.send(pack_frame(can_id, data))

    def error(self, classes, data=b""):
        head = (ERROR_FLAG | classes).to_bytes(4, sys.byteorder) + bytes([8, 0, 0, 0])
        self.end.send(head + data.ljust(8, b"\0"))

    def sent(self):
        frames = []
        while True:
            try:
                frames.append(self.end.recv(72))
            except BlockingIOError:
                return frames


@pytest.fixture
def wire(monkeypatch):
    made = Wire(monkeypatch)
    yield made
    made.end.close()
    made.port_end.close()


def test_all_that_waits_is_read_in_order_whatever_the_number_of_frames(wire):
    port = wire.port()
    wire.end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    number = sent = 0
    for batch in (0, 1, 5, 2, 9, 3):
        for _ in range(batch):
            wire.frame(0x100 + sent, bytes([sent]) * (sent % 9))
            sent += 1
        for frame in port.drain_raw():
            assert (frame.can_id, frame.data) == (0x100 + number, bytes([number]) * (number % 9))
            number += 1
    assert number == sent == 20


def test_stamp_is_the_kernels_wall_clock_time(wire):
    import time

    port = wire.port()
    before = time.time_ns()
    wire.frame(0x10, b"x")
    after = time.time_ns()
    assert before <= port.drain_raw()[0].timestamp_ns <= after


def test_remote_frames_are_left_out_and_fd_frames_are_whole(wire):
    port = wire.port(fd=True)
    wire.end.send((0x10 | REMOTE_FLAG).to_bytes(4, sys.byteorder) + bytes(12))
    wire.frame(0x800 | EXTENDED_ID_FLAG, bytes(range(64)))
    assert [(f.can_id, f.data) for f in port.drain_raw()] == [(0x800 | EXTENDED_ID_FLAG, bytes(range(64)))]


def test_receive_takes_one_frame_and_leaves_the_others(wire):
    port = wire.port()
    wire.error(0x04)
    for can_id in (1, 2, 3):
        wire.frame(can_id)
    assert port.recv_raw(1.0).can_id == 1
    assert [frame.can_id for frame in port.drain_raw()] == [2, 3]
    assert port.error_frames == 1
    assert port.recv_raw(0.0) is None


def test_bus_off_is_ridden_through_when_the_controller_restarts_in_time(wire):
    transport = wire.transport()
    wire.error(0x240, bytes([0, 0, 0, 0, 0, 0, 248, 0]))
    assert transport.drain() == []
    assert transport.bus_state is State.BUS_OFF
    assert transport.error_counters == (248, 0)
    transport.send_all([(0x181, b"old"), (0x181, b"older")])
    wire.clock.sleep(1.9)
    wire.error(0x100)
    wire.frame(0x185, b"x")
    assert [frame.can_id for frame in transport.drain()] == [0x185]
    assert transport.bus_state is State.ACTIVE
    transport.send(0x181, b"new")
    assert wire.sent() == [pack_frame(0x181, b"new")]
    assert (transport.sent, transport.not_sent) == (1, 2)
    wire.clock.sleep(10.0)
    assert transport.drain() == []


@pytest.mark.parametrize("again", [True, False])
def test_bus_off_that_lasts_ends_the_reading_however_often_it_is_told(wire, again):
    transport = wire.transport()
    wire.error(0x40)
    transport.drain()
    wire.clock.sleep(1.5)
    if again:
        wire.error(0x40)
        transport.drain()
    wire.clock.sleep(0.6)
    with pytest.raises(BusLost, match="restart-ms 100") as caught:
        transport.drain()
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 3


def test_controller_that_is_off_already_is_bus_off_from_the_start(wire):
    wire.off = True
    transport = wire.transport(bus_off_limit=0.5)
    assert transport.bus_state is State.BUS_OFF
    wire.clock.sleep(0.6)
    with pytest.raises(BusLost, match=r"not restarted within 0\.5 s"):
        transport.drain()


class Refusing:
    """A socket that refuses to send, so many times."""

    def __init__(self, sock, number, times):
        self.sock, self.number, self.times = sock, number, times

    def send(self, frame):
        if self.times:
            self.times -= 1
            raise OSError(self.number, os.strerror(self.number))
        return self.sock.send(frame)

    def __getattr__(self, name):
        return getattr(self.sock, name)


@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.EAGAIN])
def test_full_transmit_queue_is_waited_for_and_told_when_it_stays_full(wire, number):
    transport = wire.transport()
    port = transport._port
    port._poll_out = Polling(wire.clock)
    port._socket = Refusing(wire.port_end, number, 5)
    transport.send(0x10, b"x")
    assert wire.sent() == [pack_frame(0x10, b"x")]
    port._socket = Refusing(wire.port_end, number, 10_000)
    before_ns = wire.clock.now_ns
    with pytest.raises(TransmitQueueFull, match="ip link set can0 txqueuelen 100"):
        transport.send(0x10, b"x")
    assert wire.clock.now_ns - before_ns == pytest.approx(transport.send_timeout_s * 1e9, rel=0.2)
    assert (transport.sent, wire.sent()) == (1, [])


class Polling:
    def __init__(self, clock):
        self.clock = clock

    def poll(self, timeout_ms):
        self.clock.sleep(0.001)


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENETDOWN, "the interface is down; ip link set can0 up"),
        (errno.ENODEV, "the interface is gone; plug the adapter in"),
        (errno.EINVAL, os.strerror(errno.EINVAL)),
    ],
)
@pytest.mark.parametrize("told_first", [True, False])
def test_lost_interface_is_one_line_after_the_frames_that_came_before(wire, number, remedy, told_first):
    transport = wire.transport()
    port = transport._port
    for can_id in range(10):
        wire.frame(can_id)
    frames = port._reader.read()
    assert len(frames) == 10
    full = [*frames] * 6 + frames[:4]
    answers = [OSError(number, os.strerror(number)), full, frames] if told_first else [
        full, frames, OSError(number, os.strerror(number))
    ]  # fmt: skip

    class Reader:
        def read(self, at_most):
            answer = answers.pop(0) if answers else []
            if isinstance(answer, OSError):
                raise answer
            return answer

    port._reader = Reader()
    assert len(transport.drain()) == 74
    for _ in range(2):
        with pytest.raises(BusLost, match=remedy):
            transport.drain()
    port._socket = Refusing(wire.port_end, number, 1)
    with pytest.raises(BusLost, match=remedy):
        transport.send(0x10, b"x")


def test_data_that_do_not_fit_are_refused(wire):
    with pytest.raises(ValueError, match="9 data bytes; 8 fit"):
        wire.port().send_raw(0x10, bytes(9), 0.0)
    with pytest.raises(ValueError, match="65 data bytes"):
        wire.port(fd=True).send_raw(0x10, bytes(65), 0.0)


# -- options -------------------------------------------------------------------------------------------------


def test_options_have_defaults_and_python_cans_names_are_taken():
    assert options_from("x", {}) == SocketOptions()
    given = options_from(
        "x", {"receive_own_messages": True, "data_bitrate": 2_000_000, "receive_buffer": 4096}
    )
    assert given == SocketOptions(receive_buffer=4096, receive_own_messages=True)


@pytest.mark.parametrize(
    "extra",
    [
        {"receive_buffer": 0},
        {"receive_buffer": 1.5},
        {"receive_buffer": True},
        {"bus_off_limit": -1},
        {"bus_off_limit": "long"},
        {"bus_off_limit": float("nan")},
        {"bufer": 1},
    ],
)
def test_wrong_option_is_one_line_that_names_it(extra):
    with pytest.raises(BusOptionsError, match=next(iter(extra))) as caught:
        options_from("socketcan channel 'can0'", extra)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_interface_without_can_fd_says_how_to_get_it(monkeypatch, tmp_path):
    from hil.canbus import socketcan_socket

    (tmp_path / "mtu").write_text("16\n")
    monkeypatch.setattr(socketcan_socket, "Path", lambda _: tmp_path / "mtu")
    for channel, remedy in (("vcan0", "up mtu 72"), ("can0", "dbitrate 2000000 fd on")):
        with pytest.raises(BusUnavailable, match=remedy):
            socketcan_socket.open_socket(channel, None, fd=True, options=SocketOptions())


@pytest.mark.parametrize(
    ("files", "off"),
    [
        ({"device": "", "carrier": "0\n"}, True),
        ({"device": "", "carrier": "1\n"}, False),
        ({"carrier": "0\n"}, False),  # a vxcan whose other end is down
        ({}, False),
    ],
)
def test_only_an_adapter_without_a_carrier_is_bus_off(monkeypatch, tmp_path, files, off):
    from hil.canbus import socketcan_socket

    for name, text in files.items():
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(socketcan_socket, "Path", lambda _: tmp_path)
    assert socketcan_socket.is_off("can0") is off
