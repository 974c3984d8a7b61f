"""Our port on real SocketCAN: drop counter, stamps, filters, errors, bus-off, CAN FD, periodic frames."""

import errno
import itertools
import json
import os
import re
import subprocess
import sys
import time

import can
import pytest
from vcan_support import VCAN, Candump

from hil.canbus.error_frames import State, decode_error_frame
from hil.canbus.errors import BusLost, BusOptionsError, TransmitQueueFull
from hil.canbus.frame import EXTENDED_ID_FLAG
from hil.canbus.transport import BusOptions, Transport

pytestmark = pytest.mark.needs_vcan

FD = BusOptions(interface="socketcan", channel="vcan0", fd=True)


def with_options(**extra):
    return BusOptions(interface="socketcan", channel="vcan0", extra=extra)


def test_received_and_dropped_are_all_that_was_sent():
    small = with_options(receive_buffer=65_536)
    with Transport.open(small, name="slow") as slow, Transport.open(VCAN, name="fast") as fast:
        for number in range(5000):
            fast.send(0x100, number.to_bytes(4, "big"))
        dropped = slow.dropped
        frames = slow.drain()
        assert 0 < len(frames) < 1000
        assert len(frames) + dropped == 5000
        # The oldest are kept; the counter that comes with a frame tells the same as the one asked for.
        assert [int.from_bytes(f.data, "big") for f in frames] == list(range(len(frames)))
        fast.send(0x101, b"after")
        assert [frame.can_id for frame in slow.drain()] == [0x101]
        assert slow.dropped == slow._port._dropped == dropped
    assert slow.dropped == dropped  # still known when the bus is closed


def test_default_receive_buffer_holds_seconds_of_a_full_bus(record_property):
    with Transport.open(VCAN, name="slow") as slow, Transport.open(VCAN, name="fast") as fast:
        for number in range(20_000):
            fast.send(0x100, number.to_bytes(8, "big"))
        frames = slow.drain()
        record_property("figure: receive buffer", f"{len(frames)} of 20000 unread frames kept")
        assert len(frames) + slow.dropped == 20_000
        if os.geteuid() == 0:
            assert slow.dropped == 0


def test_stamps_are_the_kernels_to_the_nanosecond_and_ascend(tmp_path):
    with Transport.open(VCAN, name="b") as b, Transport.open(VCAN, name="a") as a:
        candump = Candump(tmp_path / "candump.log", "vcan0")
        before = time.time_ns()
        for number in range(300):
            a.send(0x200, bytes([number & 0xFF]))
        after = time.time_ns()
        time.sleep(0.3)
        dumped = candump.stop()
        frames = b.drain()
    stamps = [frame.timestamp_ns for frame in frames]
    assert stamps == sorted(stamps)
    assert before <= stamps[0] <= stamps[-1] <= after
    assert any(stamp % 1000 for stamp in stamps)
    # candump prints whole microseconds of the same stamp of the kernel.
    assert [stamp // 1000 for stamp in stamps] == [round(frame.time_s * 1e6) for frame in dumped]


def test_kernel_filters_take_exact_identifiers_of_both_kinds_and_no_remote_frames():
    extended = 0x123 | EXTENDED_ID_FLAG
    with (
        Transport.open(VCAN, name="node", receive=[0x123, 0x1ABCDE]) as node,
        Transport.open(VCAN, name="nothing", receive=[]) as nothing,
        Transport.open(VCAN, name="all") as everything,
        can.Bus(interface="socketcan", channel="vcan0") as sender,
    ):
        sender.send(can.Message(arbitration_id=0x123, is_remote_frame=True, is_extended_id=False))
        for can_id, is_extended in ((0x122, False), (0x123, True), (0x123, False), (0x1ABCDE, True)):
            sender.send(can.Message(arbitration_id=can_id, is_extended_id=is_extended, data=b"x"))
        assert [f.can_id for f in node.drain()] == [0x123, 0x1ABCDE | EXTENDED_ID_FLAG]
        assert nothing.drain() == []
        assert [f.can_id for f in everything.drain()] == [0x122, extended, 0x123, 0x1ABCDE | EXTENDED_ID_FLAG]
        assert everything.dropped == nothing.dropped == 0


def test_more_identifiers_than_the_kernel_filters_are_filtered_all_the_same():
    wanted = range(0x100, 0x100 + 600)
    with Transport.open(VCAN, name="node", receive=wanted) as node, Transport.open(VCAN, name="a") as a:
        for can_id in (0xFF, 0x100, 0x357, 0x358):
            a.send(can_id, b"x")
        assert [frame.can_id for frame in node.drain()] == [0x100, 0x357]


def inject(sender, can_id, data=bytes(8)):
    sender.send(can.Message(arbitration_id=can_id, is_error_frame=True, is_extended_id=False, data=data))


@pytest.fixture
def sender():
    with can.Bus(interface="socketcan", channel="vcan0") as bus:
        yield bus


def test_states_of_the_controller_are_followed(sender):
    with Transport.open(VCAN, name="node", receive=[0x10]) as node:
        seen = []
        for can_id, data in (
            (0x204, bytes([0, 0x08, 0, 0, 0, 0, 96, 0])),
            (0x204, bytes([0, 0x20, 0, 0, 0, 0, 128, 3])),
            (0x0AA, bytes([9, 0, 0x80, 0, 0, 0, 0, 0])),
            (0x240, bytes([0, 0, 0, 0, 0, 0, 248, 3])),
            (0x100, bytes(8)),
        ):
            inject(sender, can_id, data)
            assert node.drain() == []
            seen.append((node.bus_state, node.error_counters))
        assert seen == [
            (State.WARNING, (96, 0)),
            (State.PASSIVE, (128, 3)),
            (State.PASSIVE, (128, 3)),
            (State.BUS_OFF, (248, 3)),
            (State.ACTIVE, (248, 3)),
        ]
        assert node.error_frames == 5
        assert node.received == 0
        assert str(node.last_error) == "controller restarted"


def test_bus_off_discards_what_is_sent_until_the_restart(sender):
    with Transport.open(VCAN, name="node") as node, Transport.open(VCAN, name="other") as other:
        inject(sender, 0x40)
        node.drain()
        node.send_all([(0x181, b"stale"), (0x181, b"stale")])
        inject(sender, 0x100)
        node.drain()
        node.send(0x181, b"fresh")
        assert [frame.data for frame in other.drain()] == [b"fresh"]
        assert (node.sent, node.not_sent) == (1, 2)


@pytest.mark.parametrize("read", ["drain", "receive"])
def test_bus_off_without_a_restart_ends_in_one_line_with_the_remedy(sender, read):
    with Transport.open(with_options(bus_off_limit=0.05), name="node") as node:
        inject(sender, 0x40)
        assert node.drain() == []
        time.sleep(0.06)
        with pytest.raises(BusLost) as caught:
            node.drain() if read == "drain" else node.receive(None)
    assert str(caught.value) == (
        "socketcan channel 'vcan0': bus-off, and not restarted within 0.05 s; check wires, termination and"
        " bit rate, then: ip link set vcan0 type can restart; to have it restart by itself:"
        " ip link set vcan0 down; ip link set vcan0 up type can restart-ms 100"
    )


def test_error_frames_can_be_left_out(sender):
    with Transport.open(with_options(ignore_rx_error_frames=True), name="node") as node:
        inject(sender, 0x40)
        sender.send(can.Message(arbitration_id=0x10, is_extended_id=False, data=b"x"))
        assert [frame.can_id for frame in node.drain()] == [0x10]
        assert node.error_frames == 0


def test_can_fd_frames_agree_with_python_can():
    with (
        Transport.open(FD, name="node") as node,
        Transport.open(VCAN, name="classic") as classic,
        can.Bus(interface="socketcan", channel="vcan0", fd=True) as theirs,
    ):
        for length in (0, 8, 9, 12, 33, 64):
            node.send(0x55, bytes(range(length)))
            message = theirs.recv(5.0)
            assert (message.is_fd, message.dlc >= length) == (length > 8, True)
            assert bytes(message.data).rstrip(b"\0") == bytes(range(length)).rstrip(b"\0")
        theirs.send(can.Message(arbitration_id=0x66, is_extended_id=False, is_fd=True, data=bytes(range(48))))
        assert [(f.can_id, f.data) for f in node.drain()] == [(0x66, bytes(range(48)))]
        assert [len(f.data) for f in classic.drain()] == [0, 8]
        with pytest.raises(ValueError, match="9 data bytes"):
            classic.send(0x55, bytes(9))


def test_own_frames_do_not_come_back_and_others_see_them():
    with Transport.open(VCAN, name="a") as a, Transport.open(VCAN, name="b") as b:
        a.send(0x10, b"x")
        assert (len(a.drain()), len(b.drain())) == (0, 1)
    with Transport.open(with_options(receive_own_messages=True), name="a") as a:
        a.send(0x10, b"x")
        assert len(a.drain()) == 1


def test_kernel_sends_a_sequence_in_its_own_cycle_and_counts_through_it(record_property):
    with Transport.open(VCAN, name="owner") as owner, Transport.open(VCAN, name="other") as other:
        task = owner.send_periodic(0x700, [bytes([number]) for number in range(15)], 0.01, lease_s=10.0)
        time.sleep(0.5)
        task.update([bytes([number + 100]) for number in range(15)])
        time.sleep(0.3)
        task.stop()
        time.sleep(0.05)
        frames = other.drain()
        time.sleep(0.05)
        assert other.drain() == []
        assert owner.drain() == []
    numbers = [frame.data[0] for frame in frames]
    assert [number % 100 for number in numbers] == [index % 15 for index in range(len(frames))]
    assert numbers[0] == 0
    assert numbers[-1] >= 100
    periods_ms = [(b.timestamp_ns - a.timestamp_ns) * 1e-6 for a, b in itertools.pairwise(frames)]
    mean = sum(periods_ms) / len(periods_ms)
    record_property(
        "figure: BCM", f"10 ms: mean {mean:.3f}, {min(periods_ms):.3f} to {max(periods_ms):.3f} ms"
    )
    assert mean == pytest.approx(10.0, rel=0.1)


def test_periodic_message_falls_silent_when_nobody_keeps_it_alive_and_starts_again():
    with Transport.open(VCAN, name="owner") as owner, Transport.open(VCAN, name="other") as other:
        task = owner.send_periodic(0x705, b"\x05", 0.02, lease_s=0.1)
        for _ in range(25):
            time.sleep(0.02)
            task.keep_alive()
        alive = len(other.drain())
        time.sleep(0.5)  # it hangs
        after = len(other.drain())
        time.sleep(0.3)
        assert other.drain() == []
        task.keep_alive()
        time.sleep(0.1)
        again = len(other.drain())
    assert alive > 15
    assert after <= 5
    assert 1 <= again <= 6


def test_periodic_message_dies_with_its_process():
    program = (
        "import os, time; from hil.canbus.transport import *;"
        "t = Transport.open(BusOptions('socketcan', 'vcan0'), name='x');"
        "t.send_periodic(0x7AB, b'x', 0.01, lease_s=60); time.sleep(0.2); os.kill(os.getpid(), 9)"
    )
    with Transport.open(VCAN, name="other", receive=[0x7AB]) as other:
        subprocess.run([sys.executable, "-c", program], check=False)
        assert len(other.drain()) > 5
        time.sleep(0.2)
        assert other.drain() == []


def test_interface_that_goes_down_is_one_line_with_the_remedy():
    if os.geteuid() != 0:
        pytest.skip("needs root")
    subprocess.run(["ip", "link", "add", "dev", "vcan9", "type", "vcan"], check=True)
    try:
        subprocess.run(["ip", "link", "set", "up", "vcan9"], check=True)
        options = BusOptions(interface="socketcan", channel="vcan9")
        with Transport.open(options, name="node") as node, Transport.open(options, name="other") as other:
            other.send(0x10, b"last")
            subprocess.run(["ip", "link", "set", "down", "vcan9"], check=True)
            assert [frame.data for frame in node.drain()] == [b"last"]
            with pytest.raises(BusLost, match="ip link set vcan9 up"):
                node.drain()
            with pytest.raises(BusLost, match="is down"):
                node.send(0x10, b"x")
    finally:
        subprocess.run(["ip", "link", "del", "vcan9"], check=False)


def test_full_transmit_queue_is_told_with_the_remedy(monkeypatch):
    with Transport.open(VCAN, name="node", send_timeout_s=0.01) as node:

        class Full:
            def __init__(self, sock):
                self.sock = sock

            def send(self, frame):
                raise OSError(errno.ENOBUFS, os.strerror(errno.ENOBUFS))

            def __getattr__(self, name):
                return getattr(self.sock, name)

        monkeypatch.setattr(node._port, "_socket", Full(node._port._socket))
        with pytest.raises(TransmitQueueFull, match="ip link set vcan0 txqueuelen 100") as caught:
            node.send(0x10, b"x")
        assert "\n" not in str(caught.value)


def test_unknown_option_is_bad_input():
    with pytest.raises(BusOptionsError, match="no option 'recieve_buffer'; it has receive_buffer"):
        Transport.open(with_options(recieve_buffer=1), name="node")


def test_doctor_brings_a_vcan_up():
    if os.geteuid() != 0:
        pytest.skip("needs root")
    command = [sys.executable, "-m", "hil", "doctor", "--fix-vcan", "--channel", "vcan8", "--json"]
    try:
        first, second = (
            json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
            for _ in range(2)
        )
        with Transport.open(BusOptions("socketcan", "vcan8"), name="node") as node:
            node.send(0x10, b"x")
    finally:
        subprocess.run(["ip", "link", "del", "vcan8"], check=False)
    assert first["up"]
    assert [step["command"] for step in first["steps"]][1:] == [
        "ip link add dev vcan8 type vcan",
        "ip link set up vcan8",
    ]
    assert second == {"channel": "vcan8", "up": True, "steps": [], "remedy": ""}


CANDUMPS_WORDS = {
    "tx-timeout": "transmit timeout",
    "lost-arbitration": "lost arbitration",
    "controller-problem": "controller",
    "protocol-violation": "protocol violation",
    "transceiver-status": "transceiver",
    "no-acknowledgement-on-tx": "no acknowledgement",
    "bus-off": "bus-off",
    "bus-error": "bus error",
    "restarted-after-bus-off": "controller restarted",
    "rx-overflow": "receive buffer overflow",
    "tx-overflow": "transmit buffer overflow",
    "rx-error-warning": "receive errors: warning",
    "tx-error-warning": "transmit errors: warning",
    "rx-error-passive": "receive errors: passive",
    "tx-error-passive": "transmit errors: passive",
    "back-to-error-active": "error-active again",
}


def test_candump_decodes_the_same_classes_and_controller_states(sender, tmp_path):
    log = tmp_path / "errors.txt"
    with log.open("wb") as seen:
        candump = subprocess.Popen(["candump", "-e", "vcan0,0:0,#FFFFFFFF"], stdout=seen)
    try:
        time.sleep(0.5)
        injected = [(1 << bit, bytes(8)) for bit in range(9) if 1 << bit != 0x004]
        injected += [(0x004, bytes([0, 1 << bit, 0, 0, 0, 0, 0, 0])) for bit in range(7)]
        injected += [(0x1E5, bytes([0, 0x3C, 0, 0, 0, 0, 0, 0]))]
        for can_id, data in injected:
            inject(sender, can_id, data)
        time.sleep(0.5)
    finally:
        candump.terminate()
        candump.wait()
    blocks = log.read_text().split("ERRORFRAME")[1:]
    assert len(blocks) == len(injected)
    for (can_id, data), block in zip(injected, blocks, strict=True):
        words = set(re.findall(r"[a-z]+(?:-[a-z]+)+", block)) & CANDUMPS_WORDS.keys()
        ours = decode_error_frame(can_id, data)
        assert {CANDUMPS_WORDS[word] for word in words} == {*ours.classes, *ours.details}, block
