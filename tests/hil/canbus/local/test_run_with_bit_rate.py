"""`hil run` on a local bus with a bit rate: the load it measures is that of the frames on record."""

import json
import signal
import subprocess
import sys
import time
from datetime import datetime
from uuid import uuid4

import can
import pytest

from hil.canbus.contract import Contract
from hil.canbus.local.client import HilBus

LIMIT_S = 120.0


def listener(channel, filters):
    """A bus of a run that is just starting."""
    deadline_s = time.monotonic() + LIMIT_S
    while True:
        try:
            return HilBus(channel, can_filters=filters, autostart=False)
        except can.CanError:
            assert time.monotonic() < deadline_s, "the hub never came"
            time.sleep(0.1)


def run_for(seconds, out, *options):
    """`hil run` that is stopped by its user (Ctrl-C) after so long on the way; (exit code, error text)."""
    channel = f"w{uuid4().hex[:8]}"
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", "run", "-i", "hil", "-c", channel, "--out", str(out), *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    command = Contract.load().message("ATO_Command").can_id
    try:
        with listener(channel, [{"can_id": command, "can_mask": 0x7FF}]) as bus:
            assert bus.recv_raw(LIMIT_S) is not None  # the controller is there
        time.sleep(seconds)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=LIMIT_S)
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
    return process.returncode, err


@pytest.mark.realtime
def test_measured_load_of_a_run_is_that_of_its_frames(tmp_path, plain):
    out = tmp_path / "run"
    code, err = run_for(3.0, out, "-b", "500000", "--priority", "0")
    assert code == 1, err  # stopped by its user
    summary = json.loads((out / "summary.json").read_text())
    bus, start_s = summary["bus"], datetime.fromisoformat(summary["started"]).timestamp()
    assert bus["bitrate"] == 500_000
    messages = [
        message
        for message in can.LogReader(out / "frames.blf")
        if start_s <= message.timestamp <= start_s + summary["wall_time_s"]
    ]
    bits = sum(len(plain.classic(message.arbitration_id, message.data)) + 3 for message in messages)
    assert bus["load"] == pytest.approx(bits / 500_000 / summary["wall_time_s"], rel=0.01)
    assert 0.01 < bus["load"] < 0.5
    busy_until_s = 0.0
    for message in messages:  # no two frames at once
        start = message.timestamp - len(plain.classic(message.arbitration_id, message.data)) / 500_000
        assert start >= busy_until_s
        busy_until_s = message.timestamp


def test_lockstep_leaves_wire_time_out_and_says_so(tmp_path):
    out = tmp_path / "run"
    code, err = run_for(0.5, out, "--lockstep", "-b", "500000", "--json")
    assert code == 1, err  # stopped by its user
    assert "frames take no time on the wire: 500000 bit/s left out" in err
    bus = json.loads((out / "summary.json").read_text())["bus"]
    assert (bus["bitrate"], bus["load"]) == (None, None)
