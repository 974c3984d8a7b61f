"""What the tests on real SocketCAN share: candump beside a run, and `hil run` on vcan0."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from hil.canbus.contract import Contract
from hil.canbus.transport import BusOptions, Transport

VCAN = BusOptions(interface="socketcan", channel="vcan0")
ROOT = Path(__file__).resolve().parents[2]
IN_GUEST = "HIL_GUEST_KIND" in os.environ


@dataclass(frozen=True)
class Dumped:
    """One line of candump: kernel time stamp [s since the epoch], interface, identifier, data."""

    time_s: float
    channel: str
    can_id: int
    data: bytes


class Candump:
    """candump -L on interfaces (`vcan0`, or `vcan1,181:7FF` with a filter), from start to `stop`."""

    def __init__(self, log: Path, *channels: str) -> None:
        self.log = log
        with log.open("wb") as seen:
            command = ["candump", "-L", "-d", "-r", "8000000", *channels]
            self._process = subprocess.Popen(command, stdout=seen, stderr=subprocess.STDOUT)
        time.sleep(0.5)

    def stop(self) -> list[Dumped]:
        """End it and read what it saw; AssertionError if it says that it dropped frames itself."""
        self.kill(signal.SIGTERM)
        lines = self.log.read_text().splitlines()
        if lines and lines[-1].count(" ") != 2:
            lines.pop()  # it was ended in the middle of a line
        told = [line for line in lines if not line.startswith("(")]
        assert not told, told
        frames = []
        for line in lines:
            stamp, channel, frame = line.split()
            can_id, data = frame.split("#")
            frames.append(Dumped(float(stamp[1:-1]), channel, int(can_id, 16), bytes.fromhex(data)))
        return frames

    def kill(self, number: int = signal.SIGKILL) -> None:
        self._process.send_signal(number)
        self._process.wait()


def start_run(out: Path, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "hil", "run", *arguments, "-i", "socketcan", "-c", "vcan0", "--json"]
    return subprocess.Popen([*command, "--out", str(out)], stdout=subprocess.PIPE, text=True)


def wait_for_speed(speed_mps: float, bus: BusOptions = VCAN, timeout_s: float = 120.0) -> None:
    codec = Contract.load().message("ODO_Motion")
    deadline = time.monotonic() + timeout_s
    with Transport.open(bus, name="witness", receive=[codec.can_id]) as witness:
        while time.monotonic() < deadline:
            frame = witness.receive(1.0)
            if frame is not None and codec.decode(frame.data)["Speed"] > speed_mps:
                return
    raise AssertionError(f"the train never passed {speed_mps} m/s")


def assert_recorded_what_candump_saw(dumped: list[Dumped], recorded: list[tuple[int, bytes]]) -> int:
    """Frame by frame, in order, from the first recorded frame to the last; returns where candump's begin.

    The recorder joins after candump and leaves before it.
    """
    seen = [(frame.can_id, frame.data) for frame in dumped]
    first = seen.index(recorded[0])
    assert len(seen) >= first + len(recorded)
    differing = [
        (number, *pair)
        for number, pair in enumerate(zip(seen[first:], recorded, strict=False))
        if pair[0] != pair[1]
    ]
    assert differing == [], f"{len(differing)} frames differ, the first: {differing[0]}"
    return first
