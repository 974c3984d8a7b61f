"""The recorder process: listens, drains, finishes, and leaves something whole however it ends."""

from __future__ import annotations

import json
import signal
import time

import can
import numpy as np
import pytest

from hil.canbus.transport import BusOptions, Transport
from hil.record import open_run
from hil.record.process import main


@pytest.fixture
def bus(channel):
    """A sender on the test's own local bus."""
    with Transport.open(BusOptions("hil", channel), name="sender") as transport:
        yield transport


def send_motion(bus, contract, count, *, per_second=None, first=0):
    """Send numbered frames: Position is the number."""
    codec = contract.message("ODO_Motion")
    begin = time.monotonic()
    for number in range(first, first + count):
        bus.send(codec.can_id, codec.encode({"Position": number / 1000}))
        ahead_s = 0.0 if per_second is None else (number - first) / per_second - (time.monotonic() - begin)
        if ahead_s > 0.002:
            time.sleep(ahead_s)


def numbers(run):
    return run.signal("ODO_Motion.Position")[1]


def test_sigterm_drains_what_waits_finishes_the_files_and_exits_0(bus, record, contract, tmp_path):
    status = tmp_path / "status.json"
    recorder = record("--status", str(status))
    recorder.wait_ready()
    assert json.loads(status.read_text())["state"] == "ready"
    send_motion(bus, contract, 3000)
    code, error = recorder.end(signal.SIGTERM)
    assert (code, error) == (0, "")
    said = json.loads(status.read_text())
    assert (said["state"], said["frames"], said["dropped"]) == ("ended", 3000, 0)
    assert said["frames_by_message"] == {"ODO_Motion": 3000}
    run = open_run(tmp_path)
    assert run.warning == ""
    assert np.array_equal(numbers(run), np.arange(3000))
    with can.BLFReader(tmp_path / "frames.blf") as log:
        assert sum(1 for _ in log) == 3000


def test_5000_frames_a_second_are_recorded_without_loss(bus, record, contract, tmp_path):
    recorder = record()
    recorder.wait_ready()
    send_motion(bus, contract, 15_000, per_second=5_000)
    assert recorder.end(signal.SIGTERM)[0] == 0
    assert np.array_equal(numbers(open_run(tmp_path)), np.arange(15_000))


def test_a_killed_recorder_leaves_all_but_the_last_second(bus, record, contract, tmp_path):
    recorder = record()
    recorder.wait_ready()
    send_motion(bus, contract, 250, per_second=100)
    recorder.end(signal.SIGKILL)
    run = open_run(tmp_path)
    assert "did not finish" in run.warning or "cut off" in run.warning
    kept = numbers(run)
    assert np.array_equal(kept, np.arange(len(kept)))
    assert len(kept) >= 100  # 1.5 s before the end and a loaded machine's second
    assert run.messages["ODO_Motion"].signals["Position"] == "mm"
    with can.BLFReader(tmp_path / "frames.blf") as log:
        times = [message.timestamp for message in log]
    assert times == sorted(times)
    assert abs(times[0] - time.time()) < 600  # absolute time is kept too


def test_a_lost_bus_ends_the_recording_whole_with_exit_code_3(channel, record, contract, tmp_path, hub):
    recorder = record()
    recorder.wait_ready()
    with Transport.open(BusOptions("hil", channel), name="sender") as sender:
        send_motion(sender, contract, 100)
        time.sleep(0.3)
    hub.terminate()
    code, error = recorder.end()
    assert code == 3
    assert error.startswith("recorder: ")
    assert error.count("\n") == 1
    run = open_run(tmp_path)
    assert run.warning == ""
    assert len(numbers(run)) == 100


def test_properties_and_rings_reach_the_recording(bus, record, make_run, tmp_path):
    run = make_run(1.0)
    properties = tmp_path / "properties.json"
    properties.write_text('{"name": "from a file", "seed": 7}')
    ring = tmp_path / "controller.ring"
    recorder = record("--ring", f"controller={ring}", "--properties", str(properties))
    recorder.wait_ready()
    rings = run.open_rings(tmp_path)
    for row in run.rows["controller"]:
        rings["controller"].append(*row)
    assert recorder.end(signal.SIGTERM)[0] == 0
    read = open_run(tmp_path)
    assert read.properties == {"name": "from a file", "seed": 7}
    assert len(read.timing("controller")["cycle"]) == 100


def test_lockstep_frames_are_timed_by_their_ticks(bus, record, contract, tmp_path):
    recorder = record("--clock", "lockstep", "--tick-s", "0.01", "--start-ns", "1000000000000000000")
    recorder.wait_ready()
    for tick in range(50):
        for name, values in (("SYNC", {"Tick": tick}), ("ODO_Motion", {"Position": tick / 1000})):
            codec = contract.message(name)
            bus.send(codec.can_id, codec.encode(values))
    assert recorder.end(signal.SIGTERM)[0] == 0
    times, values = open_run(tmp_path).signal("ODO_Motion.Position")
    np.testing.assert_allclose(times, values * 0.01, atol=1e-12)


def test_without_a_display_a_live_view_is_one_warning_and_the_recording_goes_on(
    bus, record, contract, tmp_path, monkeypatch
):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    recorder = record("--view")
    recorder.wait_ready()
    send_motion(bus, contract, 50)
    code, error = recorder.end(signal.SIGTERM)
    assert code == 0
    assert error.count("\n") == 1
    assert "hil view --web" in error
    assert len(numbers(open_run(tmp_path))) == 50


@pytest.mark.parametrize(
    ("arguments", "words", "code"),
    [
        (["--clock", "lockstep"], "tick", 2),
        (["--ring", "controller"], "NAME=FILE", 2),
        (["--properties", "/does/not/exist.json"], "/does/not/exist.json", 2),
        (["--dbc", "/does/not/exist.dbc"], "/does/not/exist.dbc", 2),
        (["--nonsense"], "--nonsense", 2),
    ],
)
def test_a_wrong_command_line_is_one_line_and_its_exit_code(
    tmp_path, channel, capsys, bus, arguments, words, code
):
    assert main(["--out", str(tmp_path), "-i", "hil", "-c", channel, *arguments]) == code
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
