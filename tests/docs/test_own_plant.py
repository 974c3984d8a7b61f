"""The plant of "Connect your own plant", which is none of ours, is driven by our controller over the bus."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import can
import pytest
from documented import ROOT, files_of

from hil.canbus.contract import Contract

PAGE = ROOT / "docs/how-to/own-plant.md"
FAST_MPS = 2.0
LONGEST_S = 90.0

pytestmark = pytest.mark.realtime


@pytest.fixture
def start(tmp_path):
    started = []

    def begin(*arguments: str) -> None:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        started.append(subprocess.Popen([sys.executable, *arguments], cwd=tmp_path, env=environment))

    yield begin
    for process in reversed(started):
        process.send_signal(signal.SIGINT)
    for process in reversed(started):
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def test_our_controller_drives_the_plant_of_the_page(start, tmp_path, recorded, channel):
    (tmp_path / "own_plant.py").write_text(files_of(PAGE)["own_plant.py"], encoding="utf-8")
    (tmp_path / "scenario.toml").write_text((recorded / "scenario.toml").read_text())
    contract = Contract.load()
    motion, status = contract.message("ODO_Motion"), contract.message("ATO_Status")
    start("own_plant.py", "hil", channel)
    start("-m", "controller", "--scenario", "scenario.toml", "-i", "hil", "-c", channel)
    speed_mps, modes = 0.0, set()
    deadline = time.monotonic() + LONGEST_S
    with can.Bus(interface="hil", channel=channel) as bus:
        while speed_mps < FAST_MPS and time.monotonic() < deadline:
            frame = bus.recv(1.0)
            if frame is not None and frame.arbitration_id == motion.can_id:
                speed_mps = motion.decode(bytes(frame.data))["Speed"]
            elif frame is not None and frame.arbitration_id == status.can_id:
                modes.add(status.decode(bytes(frame.data))["Mode"])
    assert speed_mps >= FAST_MPS
    names = dict(status.signal("Mode").choices)
    assert "RUN" in {names[int(mode)] for mode in modes}
