"""The local bus with a bit rate, as processes: wire time, back-pressure, errors, who may join."""

import contextlib
import signal
import time
from itertools import pairwise
from uuid import uuid4

import can
import pytest

from hil.canbus.contract import Contract
from hil.canbus.local import link
from hil.canbus.local.client import HilBus, TransmitQueueFullError
from hil.canbus.local.confinement import State
from hil.canbus.local.rates import TX_QUEUE_FRAMES
from hil.canbus.local.wire import WireError
from hil.canbus.transport import BusOptions, Transport

WAIT_S = 20.0
BITRATE = 500_000
BIT_NS = 2_000


@pytest.fixture
def channel():
    return f"w{uuid4().hex[:8]}"


@pytest.fixture
def timed_hub(start_hub, channel):
    """Start a hub with 500 kbit/s."""
    return start_hub(channel, "--bitrate", str(BITRATE))


def received(bus, count):
    frames = []
    while len(frames) < count:
        frame = bus.recv_raw(WAIT_S)
        assert frame is not None, f"only {len(frames)} of {count} frames came"
        frames.append(frame)
    return frames


def error_frames(bus, until):
    """Messages up to the first one that `until` is true for."""
    messages = []
    deadline_s = time.monotonic() + WAIT_S
    while time.monotonic() < deadline_s:
        message = bus.recv(0.1)
        if message is not None:
            messages.append(message)
            if until(message):
                return messages
    pytest.fail(f"never came; there were {messages}")


# -- wire time --------------------------------------------------------------------------------------------


def test_frames_of_a_burst_follow_each_other_by_their_exact_wire_time(channel, timed_hub, plain):
    with HilBus(channel, bitrate=BITRATE) as sender, HilBus(channel) as receiver:
        sender.send_raw_all([(0x100 + n, bytes([n] * (n % 9))) for n in range(30)])
        frames = received(receiver, 30)
    for before, after in pairwise(frames):
        bits = len(plain.classic(after.can_id, after.data)) + 3
        assert after.timestamp_ns - before.timestamp_ns == bits * BIT_NS


def test_can_fd_frames_take_the_data_bit_rate_for_their_part(channel, start_hub, plain):
    start_hub(channel, "--bitrate", str(BITRATE), "--data-bitrate", "2000000")
    options = {"fd": True, "bitrate": BITRATE, "data_bitrate": 2_000_000}
    with HilBus(channel, **options) as sender, HilBus(channel, **options) as receiver:
        for number in range(10):
            sender.send(
                can.Message(arbitration_id=number, is_fd=True, bitrate_switch=True, data=bytes([number] * 64))
            )
        messages = [receiver.recv(WAIT_S) for _ in range(10)]
        told = sender.statistics()
    busy_ns = 0
    for message in messages:
        head, middle, tail = plain.fd(message.arbitration_id, bytes(message.data), extended=True, brs=True)
        busy_ns += (len(head) + len(tail) + 3) * BIT_NS + len(middle) * 500
    assert told["busy_ns"] == busy_ns


def test_urgent_frame_overtakes_those_that_wait(channel, timed_hub):
    with HilBus(channel) as slow, HilBus(channel) as urgent, HilBus(channel) as receiver:
        slow.send_raw_all([(0x700, bytes(8))] * 30)
        received(receiver, 1)
        urgent.send_raw(0x001, b"")
        order = [frame.can_id for frame in received(receiver, 30)]
    assert 0x001 in order[:-1]


def test_frame_is_received_by_its_sender_when_it_was_sent(channel, timed_hub):
    with HilBus(channel, receive_own_messages=True) as sender, HilBus(channel) as receiver:
        before_ns = time.time_ns()
        sender.send(can.Message(arbitration_id=0x12, is_extended_id=False, data=b"abc"))
        assert sender.tx_pending == 1
        own, other = sender.recv(WAIT_S), receiver.recv(WAIT_S)
        assert not own.is_rx
        assert own.timestamp == other.timestamp
        assert own.timestamp * 1e9 >= before_ns + 50 * BIT_NS
        assert sender.recv(0.2) is None
        assert sender.tx_pending == 0


def test_load_of_the_benchs_messages_is_the_computed_one(channel, timed_hub, plain):
    messages = list(Contract.load().messages.values())
    with HilBus(channel) as sender, HilBus(channel) as receiver:
        before = sender.statistics()
        for cycle in range(40):
            frames = [(m.can_id, bytes((cycle * 37 + n) & 0xFF for n in range(m.length))) for m in messages]
            for frame in frames:
                sender.send_raw(*frame, timeout=WAIT_S)
        got = received(receiver, 40 * len(messages))
        after = sender.statistics()
    bits = sum(len(plain.classic(frame.can_id, frame.data)) + 3 for frame in got)
    assert after["busy_ns"] - before["busy_ns"] == bits * BIT_NS
    assert sum(row["bits"] for row in after["messages"].values()) == bits
    assert {int(name, 16) for name in after["messages"]} == {m.can_id for m in messages}


# -- back-pressure ----------------------------------------------------------------------------------------


def test_full_transmit_queue_holds_the_sender_and_loses_nothing(channel, timed_hub):
    with HilBus(channel) as sender, HilBus(channel) as receiver:
        most = 0
        for number in range(300):
            sender.send_raw(0x10, number.to_bytes(2, "big"), timeout=WAIT_S)
            most = max(most, sender.tx_pending)
        assert TX_QUEUE_FRAMES // 2 < most <= TX_QUEUE_FRAMES
        assert [int.from_bytes(frame.data, "big") for frame in received(receiver, 300)] == list(range(300))


def test_without_time_a_full_transmit_queue_is_an_error_and_the_frame_is_not_sent(channel, start_hub):
    start_hub(channel, "--bitrate", "10000", "--tx-queue", "4")
    with HilBus(channel) as sender, HilBus(channel) as receiver:
        taken = []

        def send_without_a_pause():
            for number in range(50):
                sender.send_raw(0x10, bytes([number]), timeout=0.0)
                taken.append(number)

        with pytest.raises(TransmitQueueFullError, match=r"4 frames wait for the wire \(10000 bit/s\)"):
            send_without_a_pause()
        assert [frame.data[0] for frame in received(receiver, len(taken))] == taken
        assert receiver.recv_raw(0.3) is None


def test_frames_that_wait_are_delivered_when_their_sender_leaves_and_when_the_hub_ends(channel, start_hub):
    hub = start_hub(channel, "--bitrate", "20000")
    with HilBus(channel) as receiver:
        with HilBus(channel) as sender:
            sender.send_raw_all([(0x20, bytes([n])) for n in range(30)])
        received(receiver, 3)
        hub.end(signal.SIGTERM)
        assert [frame.data[0] for frame in received(receiver, 27)] == list(range(3, 30))


@pytest.mark.parametrize("counts_its_frames", [True, False])
def test_hub_notices_that_a_sender_with_a_full_queue_is_gone(channel, start_hub, counts_its_frames):
    hub = start_hub(channel, "--bitrate", str(BITRATE), "--tx-queue", "4", "--linger", "0.1")
    with HilBus(channel) as alone:
        if not counts_its_frames:
            alone.fileno()  # who watches it is held by the hub only
        with contextlib.suppress(TransmitQueueFullError):
            for _ in range(20):
                alone.send_raw(0x10, b"x")
    assert hub.popen.wait(WAIT_S) == 0


# -- errors -----------------------------------------------------------------------------------------------


def test_disturbed_frame_comes_later_and_both_sides_see_error_frames(channel, timed_hub):
    with HilBus(channel) as sender, HilBus(channel) as receiver:
        link.disturb(channel, can_id=0x111, count=3)
        sender.send(can.Message(arbitration_id=0x111, is_extended_id=False, data=b"ab"))
        heard = error_frames(receiver, lambda message: not message.is_error_frame)
        assert [message.is_error_frame for message in heard] == [True, True, True, False]
        assert [message.data[7] for message in heard[:3]] == [1, 2, 3]  # receive error counter
        own = [sender.recv(WAIT_S) for _ in range(3)]
        assert all(message.is_error_frame for message in own)
        assert [message.data[6] for message in own] == [8, 16, 24]  # transmit error counter
        node = sender.statistics()["clients"][0]
    assert (node["tec"], node["retransmissions"], node["state"]) == (23, 3, "error-active")


def test_bus_off_node_is_told_so_and_comes_back(channel, start_hub):
    start_hub(channel, "--bitrate", str(BITRATE), "--restart-ms", "20")
    with HilBus(channel) as sender, HilBus(channel) as receiver:
        link.disturb(channel, can_id=0x111, count=32)
        sender.send_raw(0x111, b"lost")
        told = error_frames(sender, lambda message: bool(message.arbitration_id & 0x100))  # RESTARTED
        assert any(message.arbitration_id & 0x40 for message in told)  # BUSOFF
        sender.send_raw(0x111, b"new")
        assert receiver.recv_raw(WAIT_S).data == b"new"
        assert sender.statistics()["clients"][0]["dropped"] == 1


def test_a_node_that_drains_knows_its_own_bus_state(channel, start_hub):
    start_hub(channel, "--bitrate", str(BITRATE), "--restart-ms", "200")
    options = BusOptions(interface="hil", channel=channel)
    with Transport.open(options, name="node") as node, HilBus(channel):
        states = {node.bus_state}
        link.disturb(channel, can_id=0x111, count=32)
        node.send(0x111, b"lost")
        deadline_s = time.monotonic() + WAIT_S
        while State.BUS_OFF not in states and time.monotonic() < deadline_s:
            node.drain()
            states.add(node.bus_state)
            time.sleep(0.0001)
        assert states >= {State.ACTIVE, State.BUS_OFF}
        assert node.error_frames > 0
        assert node.last_error is not None
        while node.bus_state is not State.ACTIVE and time.monotonic() < deadline_s:
            node.drain()
        assert node.bus_state is State.ACTIVE


def test_who_is_alone_is_heard_once_somebody_comes(channel, timed_hub):
    with HilBus(channel) as alone:
        alone.send_raw(0x10, b"x")
        errors = error_frames(alone, lambda message: message.data[1] == 0x20)  # transmit passive
        assert all(message.arbitration_id & 0x20 for message in errors[:-1] if message.data[1] == 0)  # ACK
        assert alone.statistics()["clients"][0]["tec"] == 128
        with HilBus(channel) as listener:
            assert listener.recv_raw(WAIT_S).data == b"x"


def test_errors_can_be_ended_and_need_a_bit_rate(channel, timed_hub, start_hub):
    link.disturb(channel, probability=1.0)
    link.disturb(channel, clear=True)
    with pytest.raises(WireError, match="probability 2 is not in"):
        link.disturb(channel, probability=2.0)
    with HilBus(channel) as sender, HilBus(channel) as receiver:
        sender.send_raw(1, b"")
        assert receiver.recv(WAIT_S).arbitration_id == 1
    start_hub(f"{channel}-2")
    with pytest.raises(WireError, match="without a bit rate"):
        link.disturb(f"{channel}-2", probability=0.5)


# -- who may join -----------------------------------------------------------------------------------------


def test_other_bit_rate_than_that_of_the_bus_is_refused_in_one_line(channel, timed_hub):
    with pytest.raises(can.CanInitializationError) as refused:
        HilBus(channel, bitrate=250_000)
    assert str(refused.value) == (
        f"channel '{channel}' of the local bus: 250000 bit/s asked for, but the bus has 500000 bit/s;"
        " all have to agree"
    )
    with pytest.raises(can.CanInitializationError, match="data bit rate 2000000 bit/s asked for"):
        HilBus(channel, bitrate=BITRATE, data_bitrate=2_000_000)
    with HilBus(channel) as bus:
        assert bus.channel_info == f"hil channel '{channel}' (500000 bit/s)"


def test_bit_rate_is_refused_by_a_bus_that_has_none(channel, start_hub):
    start_hub(channel)
    with pytest.raises(
        can.CanInitializationError, match="500000 bit/s asked for, but the bus has no bit rate"
    ):
        HilBus(channel, bitrate=BITRATE)
    with HilBus(channel) as bus:
        assert bus.tx_pending == 0
        assert bus.statistics()["bitrate"] is None


def test_client_that_starts_the_bus_gives_it_its_bit_rate(channel):
    with can.Bus(interface="hil", channel=channel, bitrate=125_000, data_bitrate=1_000_000) as bus:
        told = bus.statistics()
    assert (told["bitrate"], told["data_bitrate"]) == (125_000, 1_000_000)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--bitrate", "0"), "--bitrate 0 must be 1 or more"),
        (("--data-bitrate", "1000"), "--data-bitrate needs --bitrate"),
        (("--bitrate", "1000", "--tx-queue", "0"), "--tx-queue 0 must be 1 or more"),
    ],
)
def test_wrong_options_of_the_hub_are_bad_input(spawn, channel, options, reason):
    code, _, err = spawn("-m", "hil.canbus.local", "--channel", channel, *options).end()
    assert code == 2
    assert reason in err.splitlines()[-1]
