"""A made-up but realistic run through the real contract: one journey, every message, two timing rings."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.canbus.protection import Protector
from hil.node import TimingRing
from hil.record import Recorder, RecorderOptions, RecordingStats, Run, open_run

START_NS = 1_790_000_000_123_456_789
CYCLE_NS = 10_000_000
KMH = 3.6


@dataclass
class SyntheticRun:
    """`frames` in the order of the bus; `cycles(process)` rows of its timing ring; lockstep if asked."""

    contract: Contract
    frames: list[Frame]
    duration_s: float
    offset_ns: int
    rows: dict[str, list[tuple[float, ...]]]
    clock: str

    start_ns: ClassVar = START_NS
    cycle_ns: ClassVar = CYCLE_NS
    PROBES: ClassVar = {
        "controller": [
            ("reference_speed_mps", "m/s"), ("reference_acceleration_mps2", "m/s2"),
            ("speed_error_mps", "m/s"), ("integral", "1"),
        ],
        "plant_sim": [
            ("speed_mps", "m/s"), ("position_m", "m"), ("acceleration_mps2", "m/s^2"),
            ("traction_effort_n", "N"), ("resistance_n", "N"), ("traction_energy_j", "J"),
        ],
    }  # fmt: skip

    def open_rings(self, folder: Path, *, capacity: int = 65536) -> dict[str, TimingRing]:
        """Both rings as the nodes would make them, still empty; process name -> ring."""
        return {
            process: TimingRing(
                folder / f"{process}.ring", name=process, period_ns=CYCLE_NS, probes=self.PROBES[process],
                clock=self.clock, realtime_offset_ns=self.offset_ns, capacity=capacity,
            )
            for process in self.rows
        }  # fmt: skip

    def play(self, recorder: Recorder, rings: dict[str, TimingRing], *, block_s: float = 0.5) -> None:
        """Feed everything as it would have come, a block at a time."""
        cycles_per_block = round(block_s * 1e9 / CYCLE_NS)
        frames = iter(self.frames)
        frame = next(frames, None)
        for begin in range(0, len(self.rows["controller"]), cycles_per_block):
            until_ns = START_NS + (begin + cycles_per_block) * CYCLE_NS
            block = []
            while frame is not None and frame.timestamp_ns < until_ns:
                block.append(frame)
                frame = next(frames, None)
            for process, rows in self.rows.items():
                for row in rows[begin : begin + cycles_per_block] if process in rings else ():
                    rings[process].append(*row)
            recorder.feed(block)
            recorder.flush()
        recorder.feed([] if frame is None else [frame, *frames])

    def record(self, folder: Path, **options: Any) -> tuple[Run, RecordingStats]:
        """Record the whole run with both rings, and open it."""
        rings = self.open_rings(folder)
        options = {"rings": {name: ring.path for name, ring in rings.items()}, "start_ns": START_NS} | options
        if self.clock == "lockstep":
            options["tick_ns"] = CYCLE_NS
        with Recorder(self.contract, RecorderOptions(folder, clock=self.clock, **options)) as recorder:
            self.play(recorder, rings)
            stats = recorder.close()
        for ring in rings.values():
            ring.close()
        return open_run(folder), stats


@pytest.fixture(scope="session")
def contract() -> Contract:
    return Contract.load()


@pytest.fixture(scope="session")
def make_run(contract):
    """A function of the duration [s], the clock and the seed that gives a SyntheticRun."""

    def make(duration_s: float = 10.0, clock: str = "realtime", seed: int = 1) -> SyntheticRun:
        return _synthesise(contract, duration_s, clock, seed)

    return make


def _synthesise(contract: Contract, duration_s: float, clock: str, seed: int) -> SyntheticRun:
    random = np.random.default_rng(seed)
    cycles = round(duration_s / 0.01)
    motion = _journey(cycles)
    lockstep = clock == "lockstep"
    offset_ns = 0 if lockstep else START_NS - 5_000_000_000_000
    protectors = {c.name: Protector(c.protection) for c in contract.messages.values() if c.protection}
    frames: list[Frame] = []
    rows: dict[str, list[tuple[float, ...]]] = {"controller": [], "plant_sim": []}

    def send(at_ns: int, name: str, **values: float) -> None:
        codec = contract.message(name)
        data = codec.encode(values)
        if name in protectors:
            protectors[name].protect(data)
        frames.append(Frame(START_NS + at_ns, codec.can_id, bytes(data)))

    latency = (
        60_000 + random.gamma(2.0, 20_000.0, (2, cycles)) + 400_000 * (random.random((2, cycles)) > 0.999)
    )
    work = 350_000 + random.gamma(3.0, 30_000.0, (2, cycles))
    balise = 0
    integral = 0.0
    for k in range(cycles):
        tick_ns = k * CYCLE_NS
        t, x, v, a, v_ref, a_ref = (float(motion[name][k]) for name in ("t", "x", "v", "a", "v_ref", "a_ref"))
        running, held = 0.03 < t / duration_s < 0.9, v < 0.01 and t > 0.9 * duration_s
        mode = (
            0
            if t < 0.01 * duration_s
            else 1
            if v_ref == 0 and not held
            else 2
            if running
            else 3
            if not held
            else 4
        )
        integral += (v_ref - v) * 0.01
        if lockstep:
            send(tick_ns, "SYNC", Tick=k)
        c_ns = tick_ns + 700_000 + round(latency[0, k])
        p_ns = tick_ns + 5_700_000 + round(latency[1, k])
        send(c_ns, "ATO_Command", Mode=mode, EffortDemand=float(np.clip(a / 1.2, -1, 1)),
             HoldingBrake=int(held), EmergencyBrake=0, OdometryCounter=k % 15)  # fmt: skip
        if k % 10 == 0:
            send(c_ns + 20_000, "ATO_Heartbeat", NmtState=0 if k == 0 else 5)
            send(c_ns + 40_000, "ATO_Status", Law=3, Mode=mode, Supervision=0 if t > 0.5 else 1,
                 ReferenceSpeed=v_ref, SpeedError=v_ref - v, ReferenceAcceleration=a_ref)  # fmt: skip
            send(
                c_ns + 60_000, "ATO_Position", ReferencePosition=x, DistanceToStop=float(motion["x"][-1]) - x
            )
            measured = (0.0, 0.0) if lockstep else (latency[0, k] * 1e-9, work[0, k] * 1e-9)
            send(c_ns + 80_000, "ATO_Timing", DeadlineMisses=0, WorstSignalAge=0.0098,
                 WakeupLatency=float(measured[0]), ExecutionTime=float(measured[1]))  # fmt: skip
        if lockstep:
            send(c_ns, "ATO_SyncDone", Tick=k)
        effort, brake = max(a, 0) * 140e3, max(-a, 0) * 140e3
        fade = min(1.0, v / 3.0)
        send(p_ns, "TCU_Status", State=2 if effort > 0 else 1, TractiveEffort=effort,
             EffortAvailable=min(200e3, 1600e3 / max(v, 1.0)), CommandStatus=0, CommandAge=0.005)  # fmt: skip
        send(p_ns + 100_000, "BCU_Status", State=2 if held else 1 if brake > 0 else 0,
             PneumaticEffort=brake * (1 - fade), ElectrodynamicEffort=brake * fade, CommandStatus=0,
             HoldingApplied=int(held), EmergencyApplied=0)  # fmt: skip
        send(p_ns + 200_000, "ODO_Motion", Valid=1, Standstill=int(v < 0.01), Slip=0, Slide=0,
             Speed=max(0.0, v + random.normal(0, 0.01)), Position=x)  # fmt: skip
        if x > 200.0 * (balise + 1):
            balise += 1
            send(p_ns + 300_000, "ODO_Balise", Number=balise, Position=x)
        if k % 10 == 0:
            closed = int(t > 0.02 * duration_s and not held)
            send(p_ns + 400_000, "ATP_Permission", DoorsClosed=closed, EmergencyStop=0,
                 DepartureAuthorised=int(t > 0.025 * duration_s), TargetSpeed=0,
                 PermittedSpeed=(80 if x < 0.7 * motion["x"][-1] else 65) / KMH,
                  TargetDistance=float(motion["x"][-1]) - x)  # fmt: skip
            for node, number in (("TCU", 1), ("BCU", 2), ("ODO", 3), ("ATP", 4)):
                send(p_ns + 400_000 + 20_000 * number, f"{node}_Heartbeat", NmtState=0 if k == 0 else 5)
        if k == cycles // 2:
            send(
                p_ns + 500_000,
                "TCU_Emergency",
                ErrorCode=0x8120,
                ErrorRegister=0x11,
                Detail=60,
                SupervisionState=0,
            )
        if k == cycles // 2 + 100:
            send(p_ns + 500_000, "TCU_Emergency", ErrorCode=0, ErrorRegister=0, Detail=0, SupervisionState=0)
        if lockstep:
            send(p_ns, "TCU_SyncDone", Tick=k)
        for process, start_ns, phase_ns in (("controller", c_ns, 700_000), ("plant_sim", p_ns, 5_700_000)):
            unit = 0 if process == "controller" else 1
            woke = START_NS + start_ns - offset_ns
            scheduled = tick_ns if lockstep else START_NS + tick_ns + phase_ns - offset_ns
            busy = work[unit, k]
            read, stepped, encoded, sent = (woke + int(busy * share) for share in (0.2, 0.8, 0.85, 1.0))
            stamps = (k, scheduled, woke, read, stepped, encoded, sent, 0)
            inner = (v_ref, a_ref, v_ref - v, integral) if unit == 0 else (
                v, x, a, effort, 2_000 + 60 * v + 6 * v * v, float(motion["energy"][k]))  # fmt: skip
            rows[process].append((*stamps, *inner))
    return SyntheticRun(contract, frames, duration_s, offset_ns, rows, clock)


def _journey(cycles: int) -> dict[str, np.ndarray]:
    """Speed-up, slower speed-up, coast, brake, stand: arrays of one value a cycle, SI."""
    t = np.arange(cycles) * 0.01
    end = t[-1]
    knots = np.array([0, 0.03, 0.25, 0.45, 0.62, 0.93, 1.1]) * end
    reference = np.interp(t, knots, min(21.0, 0.25 * end) * np.array([0, 0, 0.93, 1.0, 0.9, 0, 0]))
    half = cycles // 60
    window = np.hanning(2 * half + 3)[1:-1]
    v_ref = np.convolve(np.pad(reference, half, mode="edge"), window / window.sum(), mode="valid")[:cycles]
    v = np.convolve(np.pad(v_ref, 10, mode="edge"), np.ones(21) / 21, mode="valid")[:cycles]
    a = np.gradient(v, 0.01)
    energy = np.cumsum(np.maximum(a, 0) * 140e3 * v) * 0.01
    return {
        "t": t, "v": v, "v_ref": v_ref, "a": a, "a_ref": np.gradient(v_ref, 0.01),
        "x": np.cumsum(v) * 0.01, "energy": energy,
    }  # fmt: skip


class RecorderProcess:
    """`python -m hil.record` on a local bus, its output read line by line."""

    def __init__(self, out: Path, channel: str, *arguments: str) -> None:
        command = [
            sys.executable, "-m", "hil.record", "--out", str(out), "-i", "hil", "-c", channel, *arguments,
        ]  # fmt: skip
        self.out = out
        self.popen = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def wait_ready(self) -> None:
        line = self.popen.stdout.readline()
        assert line == "ready\n", (line, self.popen.poll(), self.popen.stderr.read())

    def end(self, number: int | None = None) -> tuple[int, str]:
        """(exit code, standard error), after a signal if one is given."""
        if number is not None:
            self.popen.send_signal(number)
        _, error = self.popen.communicate(timeout=60)
        return self.popen.returncode, error


@pytest.fixture
def record(channel, tmp_path):
    """Start a recorder process on the test's own channel; killed at the end if it still runs."""
    processes = []

    def start(*arguments: str, out: Path = tmp_path) -> RecorderProcess:
        processes.append(RecorderProcess(out, channel, *arguments))
        return processes[-1]

    yield start
    for process in processes:
        if process.popen.poll() is None:
            process.popen.kill()
        process.popen.communicate()


@pytest.fixture
def hub(channel):
    """The hub of the test's own channel as a process."""
    command = [sys.executable, "-m", "hil.canbus.local", "--channel", channel]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    process.stdout.readline()
    yield process
    process.terminate()
    process.communicate(timeout=30)


@pytest.fixture(scope="session")
def line() -> dict[str, Any]:
    """A line as a recording's property `track`."""
    return {
        "start_m": -110.0, "end_m": 400.0, "train_length_m": 80.0,
        "stops": [["A", 0.0], ["B", 350.0]],
        "limits_mps": [[-110.0, 200.0, 22.0], [200.0, 400.0, 18.0]],
        "gradients_permille": [[50.0, 150.0, 20.0], [150.0, 250.0, -10.0]],
        "curves_m": [[80.0, 180.0, 300.0]], "tunnels": [[100.0, 200.0]], "balises_m": [50.0, 300.0],
    }  # fmt: skip


@pytest.fixture(scope="session")
def law() -> dict[str, Any]:
    """A law as a recording's property `law_picture`: two inputs of three terms each."""
    terms = ["N", "Z", "P"]
    corners = [[-1.0, -1.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.0, 1.0]]
    axis = {"unit": "m/s", "terms": terms, "corners": corners, "low": -1.0, "high": 1.0}
    steps = np.linspace(-1.0, 1.0, 21)
    return {
        "process": "controller", "title": "a law",
        "charts": [
            {"title": "Speed error", "unit": "m/s", "lines": [["speed_error_mps", "speed error"]],
             "levels": [["layer", 0.3, True]]},
        ],
        "surfaces": [
            {"name": "Demand", "unit": "1", "product": False,
             "error": {**axis, "name": "error", "probe": "speed_error_mps"},
             "rate": {**axis, "name": "rate", "probe": "reference_acceleration_mps2"},
             "rules": [["N", "N", "Z"], ["N", "Z", "P"], ["Z", "P", "P"]],
             "values": (0.5 * (steps[None, :] + steps[:, None])).tolist()},
        ],
    }  # fmt: skip
