"""Runs of the bench as a user starts them: as processes, from the command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import pytest

from hil.canbus.contract import Contract

HIL = [sys.executable, "-m", "hil"]


@dataclass
class Finished:
    """A run that has ended: exit code, what it printed, where its results are."""

    code: int
    stdout: str
    stderr: str
    out: Path

    @property
    def summary(self) -> dict[str, Any]:
        return json.loads((self.out / "summary.json").read_text())

    @property
    def frames(self) -> list[tuple[int, bytes]]:
        return [(m.arbitration_id, bytes(m.data)) for m in can.LogReader(self.out / "frames.blf")]

    def criterion(self, name: str) -> dict[str, Any]:
        return next(row for row in self.summary["criteria"] if row["name"] == name)


def hil(*arguments: str, cwd: Path | None = None, timeout_s: float = 240) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*HIL, *arguments], capture_output=True, text=True, timeout=timeout_s, cwd=cwd)


def one_line(text: str) -> str:
    """The only line of an error text: fails on more, and on a traceback."""
    lines = text.strip().splitlines()
    assert len(lines) == 1, text
    assert "Traceback" not in text
    return lines[0]


def finished_run(out: Path, *arguments: str) -> Finished:
    """Run `hil run … --out OUT` to its end."""
    done = hil("run", *arguments, "--out", str(out))
    return Finished(done.returncode, done.stdout, done.stderr, out)


@pytest.fixture
def run_hil(tmp_path, channel):
    """Run `hil run …` to its end."""

    def run(*arguments: str, name: str = "run", bus: bool = True) -> Finished:
        where = ["-i", "hil", "-c", f"{channel}-{name}"] if bus else []
        return finished_run(tmp_path / name, *arguments, *where)

    return run


@pytest.fixture
def start_hil(tmp_path, channel):
    """Start `hil run …`, to do something to it in mid-run; killed at the end if still there."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> tuple[subprocess.Popen[str], Path, str]:
        out = tmp_path / "run"
        process = subprocess.Popen(
            [*HIL, "run", *arguments, "-i", "hil", "-c", channel, "--out", str(out)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process, out, channel

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_for_speed(channel: str, speed_mps: float, *, timeout_s: float = 60.0) -> None:
    """Listen on the bus, as any python-can program may, until the train is faster than `speed_mps`."""
    codec = Contract.load().message("ODO_Motion")
    deadline = time.monotonic() + timeout_s
    bus = None
    while bus is None:
        try:
            bus = can.Bus(interface="hil", channel=channel, autostart=False)
        except can.CanError:
            assert time.monotonic() < deadline, "the hub never came"
            time.sleep(0.1)
    with bus:
        while time.monotonic() < deadline:
            message = bus.recv(1.0)
            if message is None or message.arbitration_id != codec.can_id:
                continue
            if codec.decode(bytes(message.data))["Speed"] > speed_mps:
                return
    raise AssertionError(f"the train never passed {speed_mps} m/s")


def children_of(pid: int) -> dict[str, int]:
    """Pid by module name (`controller`, `plant_sim`, …) of the processes that `pid` started."""
    found = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            words = (entry / "cmdline").read_bytes().split(b"\0")
        except (OSError, IndexError):
            continue
        if parent == pid and b"-m" in words:
            found[words[words.index(b"-m") + 1].decode()] = int(entry.name)
    return found


def exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
