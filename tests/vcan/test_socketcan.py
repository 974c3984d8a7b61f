"""Real SocketCAN frames through our transport; needs a vcan0 that is up."""

import json
import time

import can
import pytest
from vcan_support import VCAN, Candump, assert_recorded_what_candump_saw, start_run

from hil.canbus.errors import BusError
from hil.canbus.transport import BusOptions, Transport, default_options

pytestmark = pytest.mark.needs_vcan


def test_default_bus_is_vcan0_where_it_is_up():
    assert (default_options().interface, default_options().channel) == ("socketcan", "vcan0")


def test_frames_pass_in_order_with_kernel_stamps():
    with Transport.open(VCAN, name="a") as a, Transport.open(VCAN, name="b") as b:
        before = time.time_ns()
        for number in range(200):
            a.send(0x100 + number % 8, bytes([number]))
        time.sleep(0.1)
        frames = b.drain()
        assert [frame.data[0] for frame in frames] == list(range(200))
        assert before - 1_000_000 <= frames[0].timestamp_ns <= time.time_ns()
        assert a.drain() == []


def test_kernel_filter_passes_only_what_a_node_receives():
    with Transport.open(VCAN, name="a") as a, Transport.open(VCAN, name="b", receive=[0x123]) as b:
        for can_id in (0x122, 0x123, 0x124, 0x123):
            a.send(can_id, b"x")
        time.sleep(0.1)
        assert [frame.can_id for frame in b.drain()] == [0x123, 0x123]


def test_error_frames_are_counted_and_are_no_data():
    with Transport.open(VCAN, name="b") as b, can.Bus(interface="socketcan", channel="vcan0") as sender:
        sender.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
        sender.send(can.Message(arbitration_id=0x10, data=b"x", is_extended_id=False))
        time.sleep(0.1)
        assert [frame.can_id for frame in b.drain()] == [0x10]
        assert b.error_frames == 1


def test_missing_interface_is_one_clear_line():
    with pytest.raises(BusError, match="vcan7") as caught:
        Transport.open(BusOptions(interface="socketcan", channel="vcan7"), name="a")
    assert "\n" not in str(caught.value)


@pytest.mark.timeout(240)
def test_whole_run_in_lockstep(tmp_path):
    candump = Candump(tmp_path / "candump.log", "vcan0")
    try:
        stdout, _ = start_run(tmp_path / "run", "--lockstep").communicate(timeout=220)
    finally:
        dumped = candump.stop()
    summary = json.loads(stdout)
    assert summary["verdict"] == "passed", summary["criteria"]
    frames = can.LogReader(tmp_path / "run" / "frames.blf")
    recorded = [(message.arbitration_id, bytes(message.data)) for message in frames]
    assert len(recorded) > 50_000
    assert_recorded_what_candump_saw(dumped, recorded)
