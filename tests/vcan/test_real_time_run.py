"""The main job on real SocketCAN: the default scenario at 100 Hz in real time, with candump beside it."""

import json
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from vcan_support import IN_GUEST, Candump, Dumped, assert_recorded_what_candump_saw, start_run

import dbc
from hil.canbus.contract import Contract
from hil.record import open_run
from hil.record.reader import Run

pytestmark = [pytest.mark.needs_vcan, pytest.mark.realtime, pytest.mark.timeout(500)]

CONTROL = ("stop_error", "rms_speed_error", "overspeed", "jerk", "trip_time_error", "interventions")
NOTHING_LOST = ("frames_lost", "e2e_rejected", "cycles_not_recorded")

RELAXED = ("--set", "verdict.max_deadline_misses=450", "--set", "verdict.max_consecutive_deadline_misses=50")
"""In a guest kernel the verdict allows 5 % of the deadlines to be missed: it is a process of the host with
one CPU, and its system calls are dear. What was missed is reported."""


COMMAND_ID = Contract.load().message("ATO_Command").can_id
LIVE_S = 12.0
VOID_STALL_MS = 50.0
"""A machine that stands still for longer than the plant waits for a command interrupts the drive itself."""


@dataclass(frozen=True)
class Attempt:
    """One drive: its summary, what candump saw, and how long the whole machine stood still during it."""

    folder: Path
    summary: dict[str, Any]
    dumped: list[Dumped]
    witness: dict[str, Any]

    @property
    def passed(self) -> bool:
        return bool(self.summary["verdict"] == "passed")

    @property
    def stalls_ms(self) -> list[float]:
        """Longest first."""
        return sorted((length_ns / 1e6 for _, length_ns in self.witness["stalls"]), reverse=True)

    def __str__(self) -> str:
        stalls = self.stalls_ms
        failed = [f"{row['name']} {row['value']}" for row in self.summary["criteria"] if not row["passed"]]
        return (
            f"{self.summary['verdict']}{' (' + ', '.join(failed) + ')' if failed else ''};"
            f" the machine stood still {len(stalls)} times for more than 10 ms,"
            f" {stalls[0] if stalls else 0:.0f} ms at most, {sum(stalls):.0f} ms in all"
        )


@dataclass(frozen=True)
class Drive:
    attempts: list[Attempt]
    summary: dict[str, Any]
    dumped: list[Dumped]
    recorded: list[can.Message]
    run: Run
    decoded: list[str]

    def criteria(self, names):
        return {row["name"]: row for row in self.summary["criteria"] if row["name"] in names}


def attempt(folder: Path) -> Attempt:
    folder.mkdir()
    # In a guest into memory: a write to the host's disk stops the guest's whole kernel until it is done.
    memory = Path(tempfile.mkdtemp()) if IN_GUEST else folder
    stalls = memory / "stalls.json"
    witness = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("stall_witness.py")), str(stalls)]
    )
    candump = Candump(memory / "candump.log", "vcan0")
    try:
        process = start_run(memory / "run", *(RELAXED if IN_GUEST else ()))
        stdout, _ = process.communicate(timeout=280)
    finally:
        dumped = candump.stop()
        witness.send_signal(signal.SIGTERM)
        witness.wait(10)
        if memory != folder:
            shutil.copytree(memory, folder, dirs_exist_ok=True)
            shutil.rmtree(memory)
    summary = json.loads(stdout)
    # Only from the controller's first command to its last: a guest that starts processes has no pause, and is
    # throttled. candump has the wall clock, the witness the monotonic one.
    seen = json.loads((folder / "stalls.json").read_text())
    offset_ns = time.time_ns() - time.monotonic_ns()
    commands_s = [frame.time_s for frame in dumped if frame.can_id == COMMAND_ID]
    begin_s, end_s = (commands_s[0], commands_s[-1]) if commands_s else (0.0, 0.0)
    seen["stalls"] = [
        (at, length)
        for at, length in seen["stalls"]
        if begin_s < (at + length + offset_ns) * 1e-9 and (at + offset_ns) * 1e-9 < end_s
    ]
    return Attempt(folder, summary, dumped, seen)


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Drive:
    """Once for all tests: Cat Linh to La Thanh, 88 s; afterwards what everybody saw of it.

    Once more, and openly so, if it failed in a guest whose whole kernel stood still for VOID_STALL_MS
    meanwhile: that is the host's doing. Without that a failed drive counts, and the second one always does.
    """
    folder = tmp_path_factory.mktemp("drive")
    attempts = [attempt(folder / "1")]
    if IN_GUEST and not attempts[0].passed and max(attempts[0].stalls_ms, default=0.0) > VOID_STALL_MS:
        attempts.append(attempt(folder / "2"))
    last = attempts[-1]
    (last.folder / "latency.json").write_text(json.dumps(last.summary["timing"], indent=2) + "\n")
    with (last.folder / "candump.log").open("rb") as log:
        decoded = subprocess.run(
            [sys.executable, "-m", "cantools", "decode", "--single-line", "--no-decode-choices", dbc.path()],
            stdin=log,
            capture_output=True,
            text=True,
            check=True,
        )
    return Drive(
        attempts,
        last.summary,
        last.dumped,
        list(can.LogReader(last.folder / "run" / "frames.blf")),
        open_run(last.folder / "run"),
        [line for line in decoded.stdout.splitlines() if line],
    )


def test_train_arrives_and_meets_its_control_criteria(drive, record_property):
    for number, one in enumerate(drive.attempts, 1):
        record_property(f"figure: drive {number}", str(one))
    assert all(one.witness["looks"] > 1000 for one in drive.attempts)
    assert drive.summary["ended"] == "arrived"
    rows = drive.criteria(CONTROL)
    assert sorted(rows) == sorted(CONTROL)
    assert [row for row in rows.values() if not row["passed"]] == []
    if IN_GUEST:
        assert drive.summary["verdict"] == "passed", drive.summary["criteria"]


def test_no_frame_is_dropped_or_rejected(drive):
    assert drive.summary["bus"]["dropped"] == 0
    assert drive.summary["bus"]["frames"] > 40_000
    assert {name: row["value"] for name, row in drive.criteria(NOTHING_LOST).items()} == dict.fromkeys(
        NOTHING_LOST, 0
    )


def test_candump_and_the_frame_log_agree_frame_by_frame(drive):
    recorded = [(message.arbitration_id, bytes(message.data)) for message in drive.recorded]
    assert len(recorded) > 40_000
    first = assert_recorded_what_candump_saw(drive.dumped, recorded)
    # Both stamps are the kernel's of the same frame.
    theirs = np.array([frame.time_s for frame in drive.dumped[first : first + len(recorded)]])
    ours = np.array([message.timestamp for message in drive.recorded])
    assert np.abs(ours - theirs).max() < 20e-6


def test_cantools_decodes_from_candump_what_the_recording_says(drive):
    """Every signal of every message of the bus: an independent decoder on an independent log."""
    assert len(drive.decoded) == len(drive.dumped)
    columns: dict[str, list[float]] = {}
    for line in drive.decoded:
        message, _, signals = line.partition(" :: ")[2].rstrip(")").partition("(")
        for name, value in re.findall(r"(\w+): (-?[\d.]+(?:e[-+]?\d+)?)", signals):
            columns.setdefault(f"{message}.{name}", []).append(float(value))
    compared = 0
    for name, decoded in columns.items():
        _, recorded = drive.run.signal(name)
        if len(recorded) == 0:
            continue
        assert len(decoded) - len(recorded) <= 2, name  # the recorder leaves before candump
        np.testing.assert_allclose(recorded, decoded[: len(recorded)], rtol=1e-9, atol=1e-9, err_msg=name)
        compared += len(recorded)
    assert {"ODO_Motion.Speed", "ATO_Command.EffortDemand", "TCU_Status.TractiveEffort"} <= set(columns)
    assert compared > 200_000


@pytest.mark.parametrize("process", ["controller", "plant_sim"])
def test_wakeup_latency_is_reported(drive, process, record_property):
    """Reported, not judged: a wide band only, that a sleep of the wrong length would leave."""
    timing = drive.summary["timing"][process]
    latency = timing["wakeup_latency_us"]
    where = f"in a guest kernel, {drive.summary['environment']['kernel']}" if IN_GUEST else "natively"
    record_property(
        f"figure: {process}",
        f"wake-up latency p50 {latency['p50']:.0f} p99 {latency['p99']:.0f} p99.9 {latency['p999']:.0f} "
        f"max {latency['max']:.0f} us; {timing['missed']} of {timing['cycles']} deadlines missed, {where}",
    )
    assert timing["cycles"] > 8_000
    assert 0 < latency["p50"] < 5_000
    assert latency["p50"] <= latency["p99"] <= latency["max"]


def test_the_recording_is_a_restbus_for_a_controller_on_the_bus(drive, record_property):
    """`hil replay --live`: our own node as the device, on vcan. A guest may stall it: shares."""
    done = subprocess.run(
        [sys.executable, "-m", "hil", "replay", drive.attempts[-1].folder / "run", "--live", "--start-node",
         "--until", str(LIVE_S), "-i", "socketcan", "-c", "vcan0", "--json"],
        capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    assert done.returncode in (0, 1), done.stderr
    told = json.loads(done.stdout)
    live = told["live"]
    record_property(
        "figure: live replay",
        f"{told['restbus_frames']} frames of the restbus, late p50 {live['late_p50_us']:.0f} "
        f"p99 {live['late_p99_us']:.0f} max {live['late_max_us']:.0f} us",
    )
    assert live["dropped"] == 0
    assert not live["stopped"]
    assert told["duration_s"] == pytest.approx(LIVE_S, abs=0.5)
    (command,) = (message for message in told["messages"] if message["name"] == "ATO_Command")
    assert command["replayed"] == pytest.approx(100 * (LIVE_S - 1.0), rel=0.2)  # the first second: --settle
    (effort,) = (one for one in command["signals"] if one["name"] == "EffortDemand")
    assert effort["frames"] > 0.7 * command["recorded"]
