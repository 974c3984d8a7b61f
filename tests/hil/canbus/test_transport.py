"""A node's transport, the same over the local bus, the virtual bus and UDP multicast; and how it refuses."""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from typing import ClassVar

import can
import pytest

from hil.canbus.transport import (
    EXTENDED_ID_FLAG,
    BusError,
    BusLost,
    BusOptions,
    BusOptionsError,
    BusUnavailable,
    Frame,
    TransmitQueueFull,
    Transport,
)

WAIT_S = 10.0
IN_NAMESPACE = "HIL_TEST_OWN_NETWORK_NAMESPACE"


class TransportBackToBack:
    """Nodes on one bus."""

    def bus(self, channel):
        raise NotImplementedError

    @pytest.fixture
    def node(self, channel):
        """Let another node join the test's bus."""
        opened = []

        def open_node(receive=None, name="node", fd=False):
            options = dataclasses.replace(self.bus(channel), fd=fd)
            opened.append(Transport.open(options, name=name, receive=receive))
            return opened[-1]

        yield open_node
        for each in opened:
            each.close()

    def test_frame_arrives_unchanged(self, node):
        sender, receiver = node(), node()
        before_ns = time.time_ns()
        sender.send(0x181, bytearray(b"\x01\x02\x03"))
        frame = receiver.receive(WAIT_S)
        assert type(frame) is Frame
        assert (frame.can_id, frame.data, type(frame.data)) == (0x181, b"\x01\x02\x03", bytes)
        assert abs(frame.timestamp_ns - before_ns) < 60_000_000_000  # the same clock, ns since the epoch
        assert (sender.sent, sender.received) == (1, 0)
        assert (receiver.sent, receiver.received) == (0, 1)

    def test_extended_identifier_is_marked(self, node):
        sender, receiver = node(), node()
        sender.send(0x18181, b"")
        sender.send(EXTENDED_ID_FLAG | 0x181, b"")
        sender.send(0x181, b"")
        expected = [EXTENDED_ID_FLAG | 0x18181, EXTENDED_ID_FLAG | 0x181, 0x181]
        assert [receiver.receive(WAIT_S).can_id for _ in range(3)] == expected

    def test_drain_returns_all_that_waits_in_order(self, node):
        sender, receiver = node(), node()
        assert receiver.drain() == []
        for n in range(100):
            sender.send(0x100, bytes([n]))
        frames = [receiver.receive(WAIT_S)]
        while len(frames) < 100:
            frames += receiver.drain()
        assert [frame.data[0] for frame in frames] == list(range(100))
        assert receiver.drain() == []
        assert receiver.received == 100

    def test_unwanted_frames_do_not_end_a_drain(self, node):
        sender, receiver, all_of_them = node(), node(receive=[0x181, 0x18181]), node()
        for can_id in (
            0x100,
            0x181,
            0x101,
            0x102,
            0x103,
            0x104,
            0x18181,
            EXTENDED_ID_FLAG | 0x181,
            0x181,
            0x7FF,
        ):
            sender.send(can_id, b"x")
        for _ in range(10):
            assert all_of_them.receive(WAIT_S) is not None
        assert [frame.can_id for frame in receiver.drain()] == [0x181, EXTENDED_ID_FLAG | 0x18181, 0x181]

    def test_unwanted_frames_do_not_end_a_wait(self, node):
        sender, receiver = node(), node(receive=[0x181])
        for can_id in (0x100, 0x101, 0x181):
            sender.send(can_id, b"")
        assert receiver.receive(WAIT_S).can_id == 0x181
        assert receiver.receive(0.02) is None

    def test_node_that_wants_nothing_gets_nothing(self, node):
        sender, silent, other = node(), node(receive=[]), node()
        sender.send(0x100, b"")
        assert other.receive(WAIT_S) is not None
        assert silent.drain() == []
        assert silent.received == 0

    def test_own_frames_are_not_received(self, node):
        first, second = node(), node()
        for n in range(50):
            first.send(0x100, bytes([n]))
            second.send(0x200, bytes([n]))
        assert [first.receive(WAIT_S).can_id for _ in range(50)] == [0x200] * 50
        assert [second.receive(WAIT_S).can_id for _ in range(50)] == [0x100] * 50
        assert first.receive(0.02) is None
        assert second.receive(0.02) is None
        assert (first.dropped, second.dropped) == (0, 0)

    def test_receive_gives_up(self, node):
        receiver = node()
        assert receiver.receive(0) is None
        assert receiver.receive(0.01) is None

    def test_receive_waits_for_a_frame(self, node):
        sender, receiver = node(), node()
        timer = threading.Timer(0.05, sender.send, [0x100, b"late"])
        timer.start()
        assert receiver.receive(None).data == b"late"
        timer.join()

    def test_error_frames_are_counted_and_remote_frames_left_out(self, node, channel):
        options, receiver = self.bus(channel), node()
        tester = can.Bus(options.channel, options.interface, **options.extra)
        tester.send(can.Message(arbitration_id=0x4, is_error_frame=True, data=bytes(8)))
        tester.send(can.Message(arbitration_id=0x100, is_extended_id=False, is_remote_frame=True, dlc=3))
        tester.send(can.Message(arbitration_id=0x101, is_extended_id=False, data=b"end"))
        assert receiver.receive(WAIT_S).data == b"end"
        assert receiver.drain() == []
        assert (receiver.error_frames, receiver.received) == (1, 1)
        tester.shutdown()

    def test_too_long_data_are_the_callers_mistake(self, node):
        sender, receiver = node(), node()
        with pytest.raises(ValueError, match="9 data bytes; 8 fit, 64 with CAN FD"):
            sender.send(0x100, bytes(9))
        sender.send(0x100, bytes(8))
        assert receiver.receive(WAIT_S).data == bytes(8)
        assert sender.sent == 1

    def test_fd_carries_64_bytes(self, node):
        sender, receiver = node(fd=True), node(fd=True)
        sender.send(0x100, bytes(range(64)))
        assert receiver.receive(WAIT_S).data == bytes(range(64))

    def test_node_leaves_with_its_context(self, channel):
        with Transport.open(self.bus(channel), name="first") as node:
            node.send(0x100, b"")
        node.close()
        with pytest.raises(BusError):
            node.send(0x100, b"")


if os.environ.get(IN_NAMESPACE) == "1":

    class TestUdpMulticast(TransportBackToBack):
        def bus(self, channel):
            port = 20_000 + int(channel[-4:], 16) % 20_000
            return BusOptions("udp_multicast", "239.74.163.2", extra={"port": port, "hop_limit": 0})

        def test_lost_echoes_are_counted_as_drops(self, node):
            sender, receiver = node(), node()
            sender._port._echoes.extend([(0x300, b"lost"), (0x301, b"lost, too")])
            sender.send(0x100, b"a")
            receiver.send(0x101, b"b")
            assert sender.receive(WAIT_S).data == b"b"
            assert sender.dropped == 2
else:

    class TestHil(TransportBackToBack):
        def bus(self, channel):
            return BusOptions("hil", channel)

    class TestVirtual(TransportBackToBack):
        def bus(self, channel):
            return BusOptions("virtual", channel)

    def test_udp_multicast_in_a_network_namespace_of_its_own():
        remedy = (
            "needs the packages msgpack (Python) and iproute2, util-linux, and the right to `unshare -rn`"
        )
        script = "ip link set lo up && ip route add 224.0.0.0/4 dev lo"
        if importlib.util.find_spec("msgpack") is None or not shutil.which("unshare"):
            pytest.skip(remedy)
        if subprocess.run(["unshare", "-rn", "sh", "-c", script], capture_output=True).returncode != 0:
            pytest.skip(remedy)
        inner = f"{script} && exec {sys.executable} -m pytest -q -p no:cacheprovider {__file__} -k Udp"
        environment = os.environ | {IN_NAMESPACE: "1"}
        done = subprocess.run(
            ["unshare", "-rn", "sh", "-c", inner], capture_output=True, text=True, env=environment
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert "passed" in done.stdout


# -- the end, and a queue that is full -----------------------------------------------------------------------


def test_end_of_the_hub_is_a_lost_bus(channel, start_hub):
    hub = start_hub(channel)
    with Transport.open(BusOptions("hil", channel), name="node") as node:
        hub.end(signal.SIGTERM)
        for call in (node.drain, lambda: node.receive(None), lambda: node.send(0x100, b"")):
            with pytest.raises(BusLost) as caught:
                call()
            assert str(caught.value) == f"the hub of channel '{channel}' has ended (SIGTERM)"
            assert caught.value.exit_code == 3


def test_full_queue_is_an_error_after_the_time_limit_and_no_frame_is_lost(channel, start_hub):
    start_hub(channel, "--high-water", "50000")
    options = BusOptions("hil", channel)
    with Transport.open(options, name="plant") as slow, Transport.open(options, name="controller") as sender:
        with pytest.raises(TransmitQueueFull, match="too slow in reading: 'plant'") as caught:  # noqa: PT012
            for n in range(100_000):
                sender.send(0x100, n.to_bytes(8, "little"))
        assert caught.value.exit_code == 3
        frames = []
        while len(frames) < sender.sent:
            frames += slow.drain()
        assert [int.from_bytes(frame.data, "little") for frame in frames] == list(range(sender.sent))


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (can.CanOperationError("Transmit buffer full"), TransmitQueueFull),
        (can.CanOperationError("Failed to transmit: No buffer space available", 105), TransmitQueueFull),
        (can.CanTimeoutError(), TransmitQueueFull),
        (can.CanOperationError("Failed to transmit: Network is down", 100), BusLost),
        (OSError(100, "Network is down"), BusLost),
    ],
)
def test_errors_of_other_interfaces_are_told_apart(channel, monkeypatch, error, expected):
    def fail(*_):
        raise error

    with Transport.open(BusOptions("virtual", channel), name="node") as node:
        monkeypatch.setattr(can.interfaces.virtual.VirtualBus, "send", fail)
        with pytest.raises(expected) as caught:
            node.send(0x100, b"")
        assert str(caught.value).startswith(f"virtual channel '{channel}'")
        assert node.sent == 0


def test_drain_goes_on_where_an_interface_says_nothing_for_a_frame_it_leaves_out(channel):
    """UDP multicast without FD answers None for an FD frame though others wait behind it."""
    read, write = os.pipe()

    class Hiding(can.BusABC):
        answers: ClassVar[list] = [None, can.Message(arbitration_id=1), None, can.Message(arbitration_id=2)]

        def __init__(self):
            super().__init__("hiding")

        def fileno(self):
            return read

        def _recv_internal(self, timeout):
            os.read(read, 1)
            return self.answers.pop(0), False

        def recv(self, timeout=None):
            return self._recv_internal(timeout)[0] if self.answers else None

        def send(self, msg, timeout=None):
            raise NotImplementedError

    from hil.canbus.foreign import ForeignPort

    os.write(write, b"1234")
    bus = Hiding()
    assert [frame.can_id & 0xFF for frame in ForeignPort(bus, None).drain_raw()] == [1, 2]
    bus.shutdown()
    os.close(read)
    os.close(write)


# -- a bus that cannot be opened -----------------------------------------------------------------------------


def refusal(options, expected):
    with pytest.raises(expected) as caught:
        Transport.open(options, name="node")
    text = str(caught.value)
    assert "\n" not in text
    return text, caught.value.exit_code


def test_kernel_without_socketcan_is_one_line_with_a_remedy(monkeypatch):
    monkeypatch.setattr("hil.canbus.transport.has_socketcan", lambda: False)
    text, code = refusal(BusOptions("socketcan", "vcan0"), BusUnavailable)
    assert text == (
        "socketcan channel 'vcan0': this kernel has no SocketCAN; load the modules can_raw and vcan, "
        "or use the local bus: -i hil -c ato"
    )
    assert code == 3


def test_missing_can_interface_is_one_line_with_a_remedy(monkeypatch):
    monkeypatch.setattr("hil.canbus.transport.has_socketcan", lambda: True)
    monkeypatch.setattr("hil.canbus.transport.is_can_interface_up", lambda name: False)
    text, code = refusal(BusOptions("socketcan", "vcan7"), BusUnavailable)
    assert "no such interface that is up; 'ip link add dev vcan7 type vcan; ip link set up vcan7', or" in text
    assert code == 3


def test_missing_package_is_one_line_with_a_remedy(monkeypatch):
    monkeypatch.setattr("can.interfaces.udp_multicast.utils.msgpack", None)
    text, code = refusal(BusOptions("udp_multicast", "239.74.163.2"), BusUnavailable)
    assert "msgpack not installed; it needs the package msgpack" in text
    assert code == 3


def test_unknown_interface_is_unavailable():
    text, code = refusal(BusOptions("nosuch", "x"), BusUnavailable)
    assert "CAN interface 'nosuch' not supported" in text
    assert code == 3


def test_missing_driver_is_unavailable():
    text, _ = refusal(BusOptions("pcan", "PCAN_USBBUS1"), BusUnavailable)
    assert "The local bus needs none: -i hil -c ato" in text


def test_missing_hub_is_unavailable_when_none_may_be_started(channel):
    text, code = refusal(BusOptions("hil", channel, extra={"autostart": False}), BusUnavailable)
    assert text.startswith(f"channel '{channel}' of the local bus has no hub; start one with")
    assert code == 3


def test_impossible_channel_is_a_wrong_option():
    text, code = refusal(BusOptions("hil", "a/b"), BusOptionsError)
    assert text.startswith("channel 'a/b' of the local bus: a name starts with a letter")
    assert code == 2


def test_unknown_option_is_a_wrong_option(channel):
    text, code = refusal(BusOptions("hil", channel, extra={"autostrat": False}), BusOptionsError)
    assert (
        "no option 'autostrat'; it has autostart, bitrate, data_bitrate, fd, name, receive_own_messages"
        in text
    )
    assert code == 2


def test_refusal_is_not_also_logged(capfd):
    with pytest.raises(BusUnavailable):
        Transport.open(BusOptions("pcan", "PCAN_USBBUS1"), name="node")
    assert capfd.readouterr() == ("", "")
