"""The control step over the local bus, split, beside a loop in plain python-can and cantools on the same bus.

Both are driven by the shipped plant at 100 Hz, in slices that alternate, with a CPU of their own as in
`hil run`. The peer does less: it decodes, checks, encodes and sends the same frames, but has no supervision,
no plan and a proportional law. And it has no rehearsal: its caches are cold when it wakes.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.rows import Row
from hil.bench.placement import place
from hil.node import TimingReader
from hil.node.split import SPLIT
from hil.railway.library import find_scenario

SLICES, SLICE_S, SETTLE_CYCLES = 3, 8.0, 50
PERIOD_NS, PHASE_NS, SPIN_NS = 10_000_000, 700_000, 300_000
PRIORITY = 80
SCENARIO = "metro_1500m"
STATUS_EVERY = 10
"""Cycles between two frames of the messages of 100 ms."""

Stamps = NDArray[np.int64]


def measure() -> list[Row]:
    ours: dict[str, list[Stamps]] = {part: [] for part in SPLIT}
    peer: dict[str, list[Stamps]] = {part: [] for part in SPLIT}
    for _ in range(SLICES):
        for split, command in ((ours, "controller"), (peer, "benchmarks.control_step")):
            records = _slice(command)
            for part, (begin, end) in SPLIT.items():
                split[part].append(records[end] - records[begin])
    rows = []
    for part in ("read", "step", "encode", "send", "execution"):
        for name, percent in (("p50", 50.0), ("p99", 99.0)):
            mine, theirs = (
                float(np.percentile(np.concatenate(split[part]), percent)) / 1000 for split in (ours, peer)
            )
            rows.append(
                Row(f"control step {name}, {part}, 100 Hz", mine, theirs, "us",
                    "python-can + cantools, proportional law")
            )  # fmt: skip
    return rows


def _slice(command: str) -> NDArray[np.void]:
    """Records of one slice: hub, plant and the process that answers it."""
    channel = f"step-{os.getpid()}"
    placement = place("auto", PRIORITY)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        hub = _start(stack, "hil.canbus.local", "--channel", channel, "--priority", str(PRIORITY + 10))
        assert hub.stdout is not None
        hub.stdout.readline()
        for module, priority in (("plant_sim", PRIORITY - 5), (command, PRIORITY)):
            ring, status = folder / f"{module}.ring", folder / f"{module}.json"
            process = _start(
                stack, module, "--scenario", str(find_scenario(SCENARIO)), "-i", "hil", "-c", channel,
                "--ring", str(ring), "--status", str(status), "--priority", str(priority),
                *placement.arguments("controller" if module == command else module),
            )  # fmt: skip
            while not status.exists():
                if process.poll() is not None:
                    raise RuntimeError(f"{module} ended before it was ready, exit code {process.returncode}")
                time.sleep(0.02)
            if module != command:
                placement.keep_off([hub.pid, process.pid])
        time.sleep(SLICE_S)
        process.terminate()
        process.wait()
        records = TimingReader.open(ring).read_new()
    return records[SETTLE_CYCLES:]


def _start(stack: ExitStack, module: str, *arguments: str) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, "-m", module, *arguments], stdout=subprocess.PIPE, text=True)

    def end() -> None:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(10)
        process.kill()
        process.wait()

    stack.callback(end)
    return process


def _peer() -> int:
    """A control loop as one writes it with python-can and cantools; the ring is that of a node."""
    import can
    import cantools
    from e2e.p01 import e2e_p01_check, e2e_p01_protect

    import dbc
    from hil.canbus.contract import Contract
    from hil.node import RealTimeClock, TimingRing, realtime
    from hil.node.options import parse

    options = parse(None, program="benchmarks.control_step")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # leaves the bus, then the process
    database = cantools.database.load_file(dbc.path())
    if not isinstance(database, cantools.database.Database):
        raise TypeError(f"{dbc.path()} is no CAN database")
    data_ids = {
        name: codec.protection.data_id
        for name, codec in Contract.load().messages.items()
        if codec.protection is not None
    }
    wanted = [database.get_message_by_name(name) for name in
              ("TCU_Status", "BCU_Status", "ODO_Motion", "ATP_Permission", "ODO_Balise")]  # fmt: skip
    filters = [{"can_id": message.frame_id, "can_mask": 0x7FF, "extended": False} for message in wanted]
    by_id = {message.frame_id: message for message in wanted}
    seen: dict[str, Any] = {}
    counters: dict[str, int] = {}

    def encoded(name: str, **values: float) -> can.Message:
        message = database.get_message_by_name(name)
        given = {one.name: 0 for one in message.signals} | values
        data = bytearray(message.encode(given, strict=True))
        if name in data_ids:
            data[1] = data[1] & 0xF0 | counters.get(name, 14)
            e2e_p01_protect(data, data_ids[name])
            counters[name] = data[1] & 0x0F
        return can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=False)

    with (
        can.Bus(interface="hil", channel=options.bus.channel, can_filters=filters) as bus,
        TimingRing(options.ring or "", name="peer", period_ns=PERIOD_NS) as ring,
    ):
        ring.touch()
        realtime.request(options.priority, options.cpu)
        clock = RealTimeClock(PERIOD_NS, PHASE_NS, SPIN_NS)
        now = time.monotonic_ns
        (options.status or Path("status.json")).write_text("{}")
        cycle = 0
        while (start := clock.wait()) is not None:
            while (frame := bus.recv(0)) is not None:
                message = by_id[frame.arbitration_id]
                if message.name not in data_ids or e2e_p01_check(
                    bytearray(frame.data), data_ids[message.name]
                ):
                    seen[message.name] = message.decode(bytes(frame.data), decode_choices=False)
            read_ns = now()
            speed = seen.get("ODO_Motion", {}).get("Speed", 0.0)
            effort = max(-1.0, min(1.0, 0.1 * (10.0 - speed)))
            stepped_ns = now()
            out = [encoded("ATO_Command", Mode=2, EffortDemand=effort)]
            if cycle % STATUS_EVERY == 0:
                out += [encoded("ATO_Status", Mode=2), encoded("ATO_Position"), encoded("ATO_Timing")]
            encoded_ns = now()
            for one in out:
                bus.send(one)
            sent_ns = now()
            ring.append(cycle, start.scheduled_ns, start.woke_ns, read_ns, stepped_ns, encoded_ns, sent_ns, 0)
            clock.finished(now())
            cycle += 1
    return 0


if __name__ == "__main__":
    sys.exit(_peer())
