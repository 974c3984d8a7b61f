"""Real SocketCAN frames through our transport; needs a vcan0 that is up."""

import json
import signal
import subprocess
import sys
import time

import can
import pytest

from hil.canbus.contract import Contract
from hil.canbus.errors import BusError
from hil.canbus.transport import BusOptions, Transport, default_options
from hil.record import open_run

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


@pytest.fixture
def candump(tmp_path):
    """Candump beside the run; afterwards what it saw as (identifier, data)."""
    log = tmp_path / "candump.log"
    with log.open("wb") as seen:
        process = subprocess.Popen(["candump", "-L", "-r", "8000000", "vcan0"], stdout=seen)
        time.sleep(0.5)

        def stop():
            process.terminate()
            process.wait()
            fields = [line.split()[2].split("#") for line in log.read_text().splitlines()]
            return [(int(can_id, 16), bytes.fromhex(data)) for can_id, data in fields]

        yield stop
        process.kill()
        process.wait()


def start(out, *arguments):
    command = [sys.executable, "-m", "hil", "run", *arguments, "-i", "socketcan", "-c", "vcan0", "--json"]
    return subprocess.Popen([*command, "--out", str(out)], stdout=subprocess.PIPE, text=True)


def wait_for_speed(speed_mps, timeout_s=180.0):
    codec = Contract.load().message("ODO_Motion")
    deadline = time.monotonic() + timeout_s
    with Transport.open(VCAN, name="witness", receive=[codec.can_id]) as witness:
        while time.monotonic() < deadline:
            frame = witness.receive(1.0)
            if frame is not None and codec.decode(frame.data)["Speed"] > speed_mps:
                return
    raise AssertionError(f"the train never passed {speed_mps} m/s")


def assert_candump_saw_what_was_recorded(dumped, out):
    recorded = [
        (message.arbitration_id, bytes(message.data)) for message in can.LogReader(out / "frames.blf")
    ]
    assert len(recorded) > 3000
    first = dumped.index(recorded[0])
    assert dumped[first : first + len(recorded)] == recorded


@pytest.mark.timeout(200)
def test_whole_run_in_lockstep(tmp_path, candump):
    stdout, _ = start(tmp_path / "run", "--lockstep").communicate(timeout=180)
    summary = json.loads(stdout)
    assert summary["verdict"] == "passed", summary["criteria"]
    assert_candump_saw_what_was_recorded(candump(), tmp_path / "run")


@pytest.mark.timeout(340)
def test_driving_in_real_time_until_stopped(tmp_path, candump):
    """Function, not jitter: an emulated kernel with one processor keeps no deadlines worth judging."""
    process = start(tmp_path / "run")
    wait_for_speed(6.0)
    process.send_signal(signal.SIGINT)
    stdout, _ = process.communicate(timeout=90)
    summary = json.loads(stdout)
    assert summary["verdict"] == "aborted"
    judged = {row["name"]: row for row in summary["criteria"]}
    assert judged["frames_lost"]["value"] == 0, summary["bus"]
    assert judged["e2e_rejected"]["value"] == 0, summary["bus"]
    assert open_run(tmp_path / "run").signal("ODO_Motion.Speed")[1].max() > 5.0
    assert_candump_saw_what_was_recorded(candump(), tmp_path / "run")
