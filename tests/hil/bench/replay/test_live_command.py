"""`hil replay --live` as a process: our own node as the device on the local bus, and what can go wrong."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from hil.canbus.options import BusOptions
from hil.canbus.transport import Transport

TICK_NS = 10_000_000
SECONDS = 6.0


def start(*words):
    environment = {**os.environ, "COLUMNS": "80"}
    environment.pop("FORCE_COLOR", None)
    return subprocess.Popen(
        [sys.executable, "-m", "hil", *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip


def hil(*words):
    process = start(*words)
    out, error = process.communicate(timeout=120)
    return subprocess.CompletedProcess(words, process.returncode, out, error)


@pytest.fixture
def real_time_run(frames, run_of, contract):
    """The six seconds as a run in real time leaves them: no SYNC, the plant speaks before the controller."""
    own = {codec.can_id for codec in contract.sent_by("ATO")}
    lockstep_only = {
        contract.message(name).can_id
        for name in ("SYNC", "ATO_SyncDone", "TCU_SyncDone")
        if name in contract.messages
    }
    stamped = []
    for tick, can_id, data in frames:
        if can_id not in lockstep_only:
            phase_ns = 6_000_000 if can_id in own else 2_000_000
            stamped.append((tick * TICK_NS + phase_ns, can_id, data))
    return run_of(sorted(stamped, key=lambda frame: frame[0]))


@pytest.fixture
def bus(worker_channel):
    return ("-i", "hil", "-c", worker_channel)


@pytest.fixture
def worker_channel(tmp_path):
    return f"live-{os.getpid()}-{abs(hash(str(tmp_path))) % 10_000}"


def test_our_own_node_as_the_device_answers_as_recorded(real_time_run, bus, tmp_path):
    # Every input comes when it came in the recording, but the machine may stall a process: shares, not all.
    out = tmp_path / "out"
    done = hil(
        "replay", real_time_run, "--live", "--start-node", "--priority", "0", *bus, "--json", "--out", out
    )
    assert done.returncode in (0, 1), done.stderr
    told = json.loads(done.stdout)
    assert told["mode"] == "live"
    assert told["duration_s"] == pytest.approx(SECONDS, abs=0.2)
    assert told["wall_time_s"] >= 5.5
    assert told["live"]["dropped"] == 0
    assert told["live"]["stopped"] is False
    assert told["live"]["late_p50_us"] < 5_000
    (command,) = [message for message in told["messages"] if message["name"] == "ATO_Command"]
    assert command["replayed"] == pytest.approx(SECONDS / 0.01, rel=0.2)
    (effort,) = [one for one in command["signals"] if one["name"] == "EffortDemand"]
    assert effort["frames"] > 300
    assert effort["deviating"] < 0.3 * effort["frames"]
    assert json.loads((out / "replay.json").read_text()) == told


def test_another_law_in_the_device_is_found(real_time_run, bus):
    done = hil(
        "replay", real_time_run, "--live", "--start-node", "--priority", "0", "--set", "controller.law=pid",
        "--until", "3", *bus,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "ATO_Status" in done.stdout
    assert "Law" in done.stdout
    assert "deviates" in done.stdout
    assert max(map(len, done.stdout.splitlines()[1:])) <= 80


def test_a_device_that_does_not_speak_is_told_in_one_line(real_time_run, bus):
    done = hil("replay", real_time_run, "--live", "--wait", "0.5", *bus)
    assert (done.returncode, done.stdout) == (3, "")
    line = done.stderr.strip().splitlines()[-1]
    assert "no ATO_Command" in line
    assert "in 0.5 s" in line


def test_a_unit_that_still_speaks_for_itself_is_told(real_time_run, contract, worker_channel):
    hub = subprocess.Popen(
        [sys.executable, "-m", "hil.canbus.local", "--channel", worker_channel],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        while "ready" not in hub.stdout.readline():
            assert hub.poll() is None
        motion = contract.message("ODO_Motion")
        process = start("replay", real_time_run, "--live", "-i", "hil", "-c", worker_channel)
        with Transport.open(BusOptions("hil", worker_channel), name="odometer", receive=()) as odometer:
            while process.poll() is None:
                odometer.send(motion.can_id, bytes(motion.length))
                time.sleep(0.01)
        _, error = process.communicate(timeout=60)
    finally:
        hub.terminate()
        hub.wait()
        hub.stdout.close()
    assert process.returncode == 3
    assert f"somebody already sends 0x{motion.can_id:X}" in error
    assert len(error.strip().splitlines()) == 1


def test_a_node_that_cannot_start_is_told(real_time_run, bus):
    done = hil("replay", real_time_run, "--live", "--start-node", "--settle", "99", *bus)
    assert done.returncode == 2
    assert "nothing to compare" in done.stderr


@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT to a child: needs POSIX")
def test_an_interrupt_ends_it_and_what_was_played_is_compared(real_time_run, bus):
    process = start(
        "replay",
        real_time_run,
        "--live",
        "--start-node",
        "--priority",
        "0",
        "--settle",
        "0.2",
        *bus,
        "--json",
    )
    begin = time.monotonic()
    while time.monotonic() - begin < 60 and process.poll() is None:
        line = process.stderr.readline()
        if "waiting for" in line:
            break
    time.sleep(4.5)  # the node takes a second or two to start
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=60)
    if process.returncode == 3:
        pytest.fail(f"the device had not spoken after 4.5 s: {error}")
    told = json.loads(out)
    assert told["live"]["stopped"] is True
    assert 0.2 < told["duration_s"] < SECONDS


def test_a_recording_in_lockstep_is_refused(lockstep_run, bus):
    done = hil("replay", lockstep_run, "--live", *bus)
    assert (done.returncode, done.stdout) == (2, "")
    assert "recorded in lockstep" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--start-node"], "--start-node: only with --live"),
        (["-c", "x"], "-c: only with --live"),
        (["--live", "--until", "0"], "--until 0: must be"),
        (["--live", "--settle", "-1"], "--settle -1: must be"),
        (["--live", "-i", "virtual"], "-i virtual"),
        (["--live", "--node", "ATX"], "--node ATX: no such node"),
        (["--live", "--node", "ATO", "--start-node"], "not ATO"),
    ],
)
def test_bad_input_is_code_2_and_one_line(real_time_run, words, named):
    done = hil("replay", real_time_run, *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert named in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
