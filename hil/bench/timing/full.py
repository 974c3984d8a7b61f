"""One slice of the whole bench: hub, recorder, plant and controller as `hil run` starts them.

The nodes' timing rings are read while they run, so a slice may be as long as it likes. The bench listens to
the two messages of the control loop, ODO_Motion and ATO_Command, for signal age and command latency.
"""

from __future__ import annotations

import json
import signal
import time
from array import array
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.bench.children import Child, read_json
from hil.bench.errors import BenchError
from hil.bench.outcome import RunOptions
from hil.bench.placement import Placement, place
from hil.bench.processes import NODE_PRIORITY_OFFSET, NODES, START_TIMEOUT_S
from hil.bench.recording_properties import recording_properties
from hil.bench.shared import BusClaim, shared_folder
from hil.bench.timing.cyclictest import (
    ALIGN_S,
    Cyclictest,
    Witness,
    cpu_seconds,
    offset_between,
    witness_period_ns,
)
from hil.bench.timing.latency import chain_latency_us, period_error_us, signal_age_us, spans_us
from hil.bench.timing.misses import attributed, missed_deadlines
from hil.bench.timing.request import TimingRequest
from hil.bench.timing.samples import Slice
from hil.bench.wire import hub_arguments
from hil.canbus.contract import Contract
from hil.canbus.transport import Transport
from hil.node import CYCLE_FIELDS, TimingReader
from hil.node.inbox import bus_identifier

__all__ = ["measure_full"]

SETTLE_S = 0.5
"""Cycles so soon after the start are left out: caches fill, the train's first plan is taken over."""
POLL_S = 0.02
WITNESS_ABOVE = 11
HIGHEST_PRIORITY = 98


def measure_full(
    request: TimingRequest,
    contract: Contract,
    peer: Cyclictest | None,
    *,
    recorder: bool,
    number: int,
    waiting: Callable[[], None],
) -> Slice:
    """Run the bench for one slice. `waiting` is called all the time and may raise. Raises BenchError."""
    with ExitStack() as stack:
        bench = _Bench(request, contract, stack, recorder, number)
        bench.start(waiting)
        witness = None
        if peer is not None and peer.has_spikes and request.witness:
            witness = Witness(
                peer,
                period_ns=witness_period_ns(request.period_ns),
                priority=min(request.priority + WITNESS_ABOVE, HIGHEST_PRIORITY) if request.priority else 0,
                cpu=None,
                threshold_us=witness_threshold_us(request.period_ns),
                offset_ns=bench.quiet_offset_ns(waiting),
            )
            stack.callback(witness.abandon)
        bench.keep_off()
        bench.run(waiting, settle_s=SETTLE_S if witness is None else ALIGN_S + SETTLE_S)
        stalls = None if witness is None else witness.stop()
        return bench.slice(stalls)


def witness_threshold_us(period_ns: int) -> int:
    """Stalls of less than a twentieth of the period explain no missed deadline and are not kept."""
    return max(50, period_ns // 20_000)


class _Bench:
    def __init__(
        self, request: TimingRequest, contract: Contract, stack: ExitStack, recorder: bool, number: int
    ) -> None:
        self._request = request
        self._contract = contract
        self._recorder = recorder
        self._stack = stack
        self._bus = request.bus
        self._out = request.out / "bench" / str(number)
        self._out.mkdir(parents=True, exist_ok=True)
        self._children: dict[str, Child] = {}
        self._shared = stack.enter_context(shared_folder())
        claim = BusClaim()
        stack.callback(claim.release)
        stack.callback(self._end)
        if not claim.take(self._bus):
            raise BenchError(
                f"{self._bus.interface} {self._bus.channel}: another bench of this machine drives it;"
                " end that run, or choose another channel with -c"
            )
        self._readers: dict[str, TimingReader] = {}
        self._cycles: dict[str, list[NDArray[np.void]]] = {name: [] for name in NODES}
        self._stamps: dict[int, array[int]] = {}
        self._cpu: dict[str, float] = {}
        self._from_ns = self._until_ns = 0

    def start(self, waiting: Callable[[], None]) -> None:
        """Start everything in the order in which it is needed."""
        request, bus, shared = self._request, self._bus, self._shared
        if bus.interface == "hil":
            arguments = hub_arguments(bus, self._priority("hub"))
            self._spawn("hub", "hil.canbus.local", arguments).wait_for_line("ready", START_TIMEOUT_S, waiting)
        watched = [bus_identifier(self._contract.message(name)) for name in ("ODO_Motion", "ATO_Command")]
        self._odometry, self._command = watched
        self._stamps = {can_id: array("q") for can_id in watched}
        self._transport = self._stack.enter_context(Transport.open(bus, name="timing", receive=watched))
        if self._transport.receive(0.15) is not None:
            raise BenchError(
                f"{bus.interface} {bus.channel}: already carries frames of another bench;"
                " end that run, or choose another channel with -c"
            )
        scenario = self._out / "scenario.toml"
        request.scenario.write(scenario)
        common = ["--clock", "realtime", *bus.to_arguments(), "--die-with-parent"]
        if self._recorder:
            options = RunOptions(request.scenario, self._out, bus)
            properties = self._out / "properties.json"
            properties.write_text(json.dumps(recording_properties(options)), encoding="utf-8")
            arguments = ["--out", str(self._out), "--properties", str(properties), *common]
            arguments += ["--status", str(shared / "recorder.json"), "--tick-s", repr(options.tick_s)]
            for name in ("controller", "plant_sim"):
                arguments += ["--ring", f"{name}={shared / name}.ring"]
            self._spawn("recorder", "hil.record", arguments)
        for name in NODES:
            arguments = ["--scenario", str(scenario), *common]
            arguments += ["--ring", f"{shared / name}.ring", "--status", str(shared / f"{name}.json")]
            arguments += ["--priority", str(self._priority(name)), *request.scenario.timing.arguments()]
            spin = "auto" if request.spin_ns is None else f"{request.spin_ns // 1000}"
            arguments += ["--spin-us", spin]
            if request.cpu is not None and name == "controller":
                arguments += ["--cpu", str(request.cpu)]
            self._spawn(name, name, arguments)
        # All at once: whether the first frames are on record does not matter here.
        if self._recorder:
            self._children["recorder"].wait_for_line("ready", START_TIMEOUT_S, waiting)
        for name in NODES:
            self._children[name].wait_for_file(
                shared / f"{name}.json", "state", "ready", START_TIMEOUT_S, waiting
            )
            self._readers[name] = TimingReader.open(shared / f"{name}.ring")

    def keep_off(self) -> None:
        """Everybody but the controller, this process too, goes off the controller's CPU."""
        cpu = self._request.cpu
        placement = Placement() if cpu is None else place(cpu, None)
        placement.keep_off(child.pid for name, child in self._children.items() if name != "controller")
        self._stack.enter_context(placement.launcher_kept_off())

    def quiet_offset_ns(self, waiting: Callable[[], None]) -> int:
        """Where the witness's wake-ups are farthest from the deadlines of both nodes."""
        deadline = time.monotonic() + START_TIMEOUT_S
        while not all(self._cycles.values()) and time.monotonic() < deadline:
            self._read()
            waiting()
            time.sleep(POLL_S)
        deadlines = [int(kept[-1]["scheduled_ns"][-1]) for kept in self._cycles.values() if kept]
        return offset_between(deadlines, witness_period_ns(self._request.period_ns))

    def run(self, waiting: Callable[[], None], *, settle_s: float) -> None:
        """Let it run for the slice, reading what it says; the first `settle_s` are not counted."""
        self._from_ns = time.monotonic_ns() + round(settle_s * 1e9)
        self._until_ns = self._from_ns + round(self._request.slice_s * 1e9)
        used: dict[str, float] = {}
        measured_from = 0
        while (now := time.monotonic_ns()) < self._until_ns:
            if not used and now >= self._from_ns:
                used, measured_from = self._cpu_seconds(), now
            self._read()
            for child in self._children.values():
                if not child.running:
                    raise BenchError(child.last_words())
            waiting()
            time.sleep(POLL_S)
        elapsed = (time.monotonic_ns() - measured_from) * 1e-9
        self._cpu = {
            name: (seconds - used[name]) / elapsed
            for name, seconds in self._cpu_seconds().items()
            if name in used
        }
        self._read()

    def slice(self, stalls: list[Any] | None) -> Slice:
        """What was measured; ends the bench, for its last words."""
        self._end()
        cycles = {name: self._within(name) for name in NODES}
        controller = cycles["controller"]
        if len(controller) < 2:
            raise BenchError("controller: it made no cycle in this slice; see " + str(self._out / "logs"))
        offset = self._readers["controller"].header.realtime_offset_ns
        odometry, command = (
            np.frombuffer(self._stamps[can_id], np.int64) - offset
            for can_id in (self._odometry, self._command)
        )
        status = {name: read_json(self._shared / f"{name}.json") for name in NODES}
        misses = [
            miss for name in NODES for miss in missed_deadlines(name, cycles[name], self._request.period_ns)
        ]
        plant = cycles["plant_sim"]
        for reader in self._readers.values():
            reader.close()
        return Slice(
            wakeup_latency_us=(controller["woke_ns"] - controller["scheduled_ns"]) / 1e3,
            period_error_us=period_error_us(controller),
            spans_us=spans_us(controller),
            execution_us=(controller["sent_ns"] - controller["woke_ns"]) / 1e3,
            signal_age_us=signal_age_us(controller["read_ns"], odometry),
            command_latency_us=chain_latency_us(self._inside(odometry), self._inside(command)),
            plant_latency_us=(plant["woke_ns"] - plant["scheduled_ns"]) / 1e3,
            cpu_share=self._cpu,
            missed={name: int(cycles[name]["missed"][1:].sum()) for name in NODES},
            misses=misses
            if stalls is None
            else attributed(misses, stalls, witness_period_ns(self._request.period_ns)),
            witnessed=stalls is not None,
            frames_lost=frames_lost(status),
            rights=rights(status),
            series_ns=controller["scheduled_ns"].astype(np.int64),
        )

    def _within(self, name: str) -> NDArray[np.void]:
        if not self._cycles[name]:
            raise BenchError(f"{name}: it made no cycle in this slice; see {self._out / 'logs'}")
        cycles = np.concatenate(self._cycles[name])
        inside = (cycles["scheduled_ns"] >= self._from_ns) & (cycles["sent_ns"] <= self._until_ns)
        kept: NDArray[np.void] = cycles[inside]
        return kept

    def _inside(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        return stamps_ns[(stamps_ns >= self._from_ns) & (stamps_ns <= self._until_ns)]

    def _read(self) -> None:
        for frame in self._transport.drain():
            stamps = self._stamps.get(frame.can_id)
            if stamps is not None:
                stamps.append(frame.timestamp_ns)
        for name, reader in self._readers.items():
            new = reader.read_new()
            if len(new):  # the stamps alone: probes of an hour at 1 kHz would be gigabytes
                self._cycles[name].append(new[list(CYCLE_FIELDS)].copy())

    def _priority(self, name: str) -> int:
        if not self._request.priority:
            return 0
        return min(max(self._request.priority + NODE_PRIORITY_OFFSET[name], 1), HIGHEST_PRIORITY)

    def _spawn(self, name: str, module: str, arguments: list[str]) -> Child:
        child = Child(name, module, arguments, logs=self._out / "logs")
        self._children[name] = child
        return child

    def _cpu_seconds(self) -> dict[str, float]:
        used = {name: cpu_seconds(child.pid) for name, child in self._children.items()}
        return {name: seconds for name, seconds in used.items() if seconds is not None}

    def _end(self) -> None:
        for name in NODES:  # both at once, or the one that stays would report the other's silence
            if name in self._children:
                self._children[name].signal(signal.SIGTERM)
        for name in ("controller", "plant_sim", "recorder", "hub"):
            child = self._children.pop(name, None)
            if child is not None:
                child.end(timeout_s=60.0 if name == "recorder" else 10.0)


def frames_lost(status: dict[str, Any]) -> int:
    """Frames that did not reach a node: drops of its interface and gaps in the E2E counters."""
    lost = 0
    for node in status.values():
        lost += int(node.get("frames", {}).get("dropped", 0))
        lost += sum(int(row.get("lost", 0)) for row in node.get("e2e", {}).values())
    return lost


def rights(status: dict[str, Any]) -> dict[str, Any]:
    """The rights that all nodes have, and how the controller waits for its deadlines."""
    return {
        "sched_fifo": all(bool(node.get("sched_fifo")) for node in status.values()),
        "mlock": all(bool(node.get("mlock")) for node in status.values()),
        "cpu_idle": all(
            node.get("rights", {}).get("cpu_idle", {}).get("state") == "granted" for node in status.values()
        ),
        "spin": dict(status.get("controller", {}).get("spin") or {}),
        "rehearsal": dict(status.get("controller", {}).get("rehearsal") or {}),
    }
