"""What every bus of this bench must do, run over the local bus and over python-can's virtual one."""

from __future__ import annotations

import asyncio
import threading
from typing import ClassVar

import can
import pytest

KINDS = {
    "standard": {"arbitration_id": 0x7FF, "is_extended_id": False, "data": b"\x01\x02\x03"},
    "lowest": {"arbitration_id": 0, "is_extended_id": False, "data": bytes(8)},
    "extended": {"arbitration_id": 0x1FFFFFFF, "is_extended_id": True, "data": b"\xff" * 8},
    "extended_low_id": {"arbitration_id": 0x181, "is_extended_id": True, "data": b"x"},
    "empty": {"arbitration_id": 0x181, "is_extended_id": False},
    "remote": {"arbitration_id": 0x181, "is_extended_id": False, "is_remote_frame": True, "dlc": 5},
    "extended_remote": {"arbitration_id": 0x18181, "is_remote_frame": True, "dlc": 0},
    "error": {
        "arbitration_id": 0x4,
        "is_extended_id": False,
        "is_error_frame": True,
        "data": bytes(range(8)),
    },
    "fd": {"arbitration_id": 0x181, "is_extended_id": False, "is_fd": True, "data": bytes(range(64))},
    "fd_short": {"arbitration_id": 0x181, "is_extended_id": False, "is_fd": True, "data": b"ab"},
    "fd_switched": {"arbitration_id": 0x181, "is_fd": True, "bitrate_switch": True, "data": bytes(12)},
    "fd_passive": {
        "arbitration_id": 0x181,
        "is_fd": True,
        "bitrate_switch": True,
        "error_state_indicator": True,
        "data": bytes(48),
    },
}
WAIT_S = 10.0  # a frame that is due comes long before


def message(number, can_id=0x100):
    return can.Message(arbitration_id=can_id, is_extended_id=False, data=number.to_bytes(4, "little"))


def number(received):
    return int.from_bytes(received.data, "little")


class BackToBack:
    """Two or more buses of one interface on one channel."""

    interface = ""
    options: ClassVar[dict] = {}

    @pytest.fixture
    def bus(self, channel):
        """Open another bus on the test's channel."""
        opened = []

        def open_bus(**options):
            opened.append(can.Bus(interface=self.interface, channel=channel, **(self.options | options)))
            return opened[-1]

        yield open_bus
        for each in opened:
            each.shutdown()

    @pytest.mark.parametrize("kind", KINDS)
    def test_every_kind_of_frame_arrives_unchanged(self, bus, channel, kind):
        sender, receiver = bus(), bus()
        sent = can.Message(check=True, **KINDS[kind])
        sender.send(sent)
        received = receiver.recv(WAIT_S)
        assert received.equals(sent, timestamp_delta=None, check_channel=False), (sent, received)
        assert received.channel == channel
        assert received.is_rx

    def test_frames_keep_their_order(self, bus):
        sender, receiver = bus(), bus()
        for n in range(500):
            sender.send(message(n))
        assert [number(receiver.recv(WAIT_S)) for _ in range(500)] == list(range(500))
        assert receiver.recv(0) is None

    def test_frame_reaches_every_other_bus_once(self, bus):
        sender, *receivers = bus(), bus(), bus(), bus()
        sender.send(message(7))
        for receiver in receivers:
            assert number(receiver.recv(WAIT_S)) == 7
            assert receiver.recv(0) is None

    def test_own_frames_are_not_received(self, bus):
        sender, other = bus(), bus()
        sender.send(message(1))
        other.send(message(2))
        assert number(sender.recv(WAIT_S)) == 2
        assert sender.recv(0) is None

    def test_own_frames_are_received_on_request_and_marked(self, bus):
        sender, other = bus(receive_own_messages=True), bus()
        sender.send(message(1))
        received = sender.recv(WAIT_S)
        assert number(received) == 1
        assert not received.is_rx
        assert other.recv(WAIT_S).is_rx

    def test_recv_gives_up_after_its_timeout(self, bus):
        receiver = bus()
        assert receiver.recv(0) is None
        assert receiver.recv(0.01) is None

    def test_recv_wakes_up_when_a_frame_comes(self, bus):
        sender, receiver = bus(), bus()
        timer = threading.Timer(0.05, sender.send, [message(3)])
        timer.start()
        assert number(receiver.recv(None)) == 3
        timer.join()

    def test_timestamps_never_go_back(self, bus):
        sender, receiver = bus(), bus()
        for n in range(50):
            sender.send(message(n))
        stamps = [receiver.recv(WAIT_S).timestamp for _ in range(50)]
        assert stamps == sorted(stamps)
        assert stamps[0] > 1e9

    def test_filter_lets_through_what_matches(self, bus):
        sender = bus()
        receiver = bus(can_filters=[{"can_id": 0x180, "can_mask": 0x7F0, "extended": False}])
        for can_id in (0x17F, 0x180, 0x18F, 0x190, 0x181):
            sender.send(message(can_id, can_id))
        sender.send(can.Message(arbitration_id=0x180, is_extended_id=True))
        sender.send(message(0x182, 0x182))
        assert [receiver.recv(WAIT_S).arbitration_id for _ in range(4)] == [0x180, 0x18F, 0x181, 0x182]

    def test_filter_without_kind_takes_both_kinds(self, bus):
        sender, receiver = bus(), bus(can_filters=[{"can_id": 0x123, "can_mask": 0x7FF}])
        sender.send(can.Message(arbitration_id=0x123, is_extended_id=True))
        sender.send(can.Message(arbitration_id=0x124, is_extended_id=False))
        sender.send(can.Message(arbitration_id=0x123, is_extended_id=False))
        assert [receiver.recv(WAIT_S).is_extended_id for _ in range(2)] == [True, False]
        assert receiver.recv(0) is None

    def test_filters_can_be_changed_and_taken_away(self, bus):
        sender, receiver = bus(), bus()
        receiver.set_filters([{"can_id": 0x200, "can_mask": 0x7FF}])
        sender.send(message(1, 0x100))
        sender.send(message(2, 0x200))
        assert number(receiver.recv(WAIT_S)) == 2
        receiver.set_filters(None)
        sender.send(message(3, 0x100))
        assert number(receiver.recv(WAIT_S)) == 3

    def test_notifier_hands_over_every_frame(self, bus):
        sender, receiver = bus(), bus()
        reader = can.BufferedReader()
        with can.Notifier(receiver, [reader], timeout=0.1):
            for n in range(200):
                sender.send(message(n))
            assert [number(reader.get_message(WAIT_S)) for _ in range(200)] == list(range(200))

    def test_asyncio_notifier_hands_over_every_frame(self, bus):
        sender, receiver = bus(), bus()
        for n in range(5):  # these wait already when the notifier starts
            sender.send(message(n))

        async def collect():
            reader = can.AsyncBufferedReader()
            notifier = can.Notifier(receiver, [reader], timeout=0.1, loop=asyncio.get_running_loop())
            for n in range(5, 200):
                sender.send(message(n))
            numbers = [number(await asyncio.wait_for(reader.get_message(), WAIT_S)) for _ in range(200)]
            notifier.stop()
            return numbers

        assert asyncio.run(collect()) == list(range(200))

    def test_periodic_task_sends(self, bus):
        sender, receiver = bus(), bus()
        task = sender.send_periodic(message(9), 0.001)
        assert [number(receiver.recv(WAIT_S)) for _ in range(5)] == [9] * 5
        task.stop()

    def test_closed_bus_refuses_with_a_can_error(self, bus):
        closed = bus()
        closed.shutdown()
        closed.shutdown()
        with pytest.raises(can.CanOperationError):
            closed.send(message(1))
        with pytest.raises(can.CanOperationError):
            closed.recv(0)


class TestHil(BackToBack):
    interface = "hil"
    options: ClassVar[dict] = {"fd": True}


class TestVirtual(BackToBack):
    interface = "virtual"
    options: ClassVar[dict] = {"protocol": can.CanProtocol.CAN_FD}
