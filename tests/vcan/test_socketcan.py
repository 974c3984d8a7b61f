"""Real SocketCAN frames through our transport; needs a vcan0 that is up."""

import json
import subprocess
import sys
import time

import can
import pytest

from hil.canbus.errors import BusError
from hil.canbus.transport import BusOptions, Transport, default_options

pytestmark = pytest.mark.needs_vcan

VCAN = BusOptions(interface="socketcan", channel="vcan0")


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


@pytest.mark.timeout(200)
@pytest.mark.parametrize("mode", [["--lockstep"], []], ids=["lockstep", "real-time"])
def test_whole_run_on_vcan0(tmp_path, mode):
    """The default scenario over the kernel's CAN; candump beside it sees the recorded frames."""
    out = tmp_path / "run"
    seen = (tmp_path / "candump.log").open("wb")
    candump = subprocess.Popen(["candump", "-L", "-r", "8000000", "vcan0"], stdout=seen)
    try:
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "hil",
                "run",
                *mode,
                "-i",
                "socketcan",
                "-c",
                "vcan0",
                "--out",
                str(out),
                "--json",
            ],
            capture_output=True,
            text=True,
            timeout=180,
        )
    finally:
        candump.terminate()
        candump.wait()
        seen.close()
    summary = json.loads(done.stdout)
    control = {row["name"]: row for row in summary["criteria"]}
    judged = (
        "stop_error",
        "rms_speed_error",
        "overspeed",
        "jerk",
        "trip_time_error",
        "frames_lost",
        "e2e_rejected",
    )
    assert [name for name in judged if not control[name]["passed"]] == [], summary["criteria"]
    lines = (tmp_path / "candump.log").read_text().splitlines()
    recorded = [(m.arbitration_id, bytes(m.data)) for m in can.LogReader(out / "frames.blf")]
    dumped = [(int(line.split()[2].split("#")[0], 16), bytes.fromhex(line.split("#")[1])) for line in lines]
    first = dumped.index(recorded[0])
    assert dumped[first : first + len(recorded)] == recorded
