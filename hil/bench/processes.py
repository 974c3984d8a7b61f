"""A run as separate processes on one bus: hub, recorder, plant, controller, and this launcher.

The launcher is the node BENCH. It starts the others in the order in which they are needed, watches
them, and ends them in the order in which they can be missed: the controller first, so that the
plant still brakes the train, and the recorder after both, so that it hears their last words.
"""

from __future__ import annotations

import json
import signal
import time
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hil.bench.braking import BY_THE_USER, Cut
from hil.bench.children import Child, read_json
from hil.bench.errors import Aborted, BenchError
from hil.bench.outcome import Interrupted, Outcome, RunOptions, Show
from hil.bench.placement import Placement, place
from hil.bench.recording_properties import recording_properties
from hil.bench.shared import BusClaim, shared_folder
from hil.bench.sync import BenchNode
from hil.bench.watch import Ending, Watch
from hil.bench.wire import hub_arguments, timed_bus, traffic_between, wire_counters
from hil.canbus.contract import Contract
from hil.canbus.errors import BusError
from hil.canbus.transport import BusOptions, Transport
from hil.node.inbox import bus_identifier
from hil.node.start_limit import start_limit_s

START_TIMEOUT_S = start_limit_s()

NODES = ("plant_sim", "controller")
"""In the order in which they are started."""

NODE_PRIORITY_OFFSET = {"hub": 10, "controller": 0, "plant_sim": -5}
"""SCHED_FIFO order: the bus before the controller before the plant, as wires are faster than units."""

LISTEN_BEFORE_START_S = 0.25
"""Longer than the slowest cycle of the bench's own messages (100 ms): a bench elsewhere is heard."""


def run_in_processes(
    options: RunOptions, contract: Contract, *, show: Show, interrupted: Interrupted
) -> Outcome:
    """Run a scenario in separate processes, in real time or in lockstep.

    Raises BenchError or BusError if something cannot be started, Aborted if the user asks to stop before
    the run has begun; whatever ends the run after that is in the outcome.
    """
    return _ProcessRun(options, contract, show, interrupted).run()


class _ProcessRun:
    def __init__(self, options: RunOptions, contract: Contract, show: Show, interrupted: Interrupted) -> None:
        self._options = options
        self._contract = contract
        self._show = show
        self._interrupted = interrupted
        self._children: dict[str, Child] = {}
        self._codes: dict[str, int] = {}
        self._claim = BusClaim()
        self._bus = timed_bus(options)
        self._watch = Watch(contract, time_limit_s=options.time_limit_s)
        self._placement = Placement()
        if not options.lockstep:
            self._placement = place(options.scenario.timing.controller_cpu, options.priority)

    def run(self) -> Outcome:
        with ExitStack() as stack:
            shared = stack.enter_context(shared_folder())
            stack.callback(self._claim.release)
            stack.callback(self._end_everything)
            self._bus = self._settle_bus()
            done = bus_identifier(self._contract.message("TCU_SyncDone"))
            transport = stack.enter_context(
                Transport.open(self._bus, name="bench", receive=[*self._watch.identifiers, done])
            )
            bench = BenchNode(transport, self._contract, self._watch, tick_s=self._options.tick_s)
            self._start(shared)
            stack.enter_context(self._placement.launcher_kept_off())
            started = datetime.now(UTC)
            wire = wire_counters(self._bus)
            clock = time.monotonic()
            if self._options.lockstep:
                ending, simulated_s = self._drive_lockstep(bench)
            else:
                ending, simulated_s = self._drive_real_time(bench)
            wall_s = time.monotonic() - clock
            wire = traffic_between(wire, wire_counters(self._bus))
            self._end_everything()
            return Outcome(
                ending=ending,
                bus=self._bus,
                started=started.isoformat(timespec="milliseconds"),
                wall_time_s=wall_s,
                simulated_time_s=simulated_s,
                one_process=False,
                nodes={name: self._last_status(shared, name) for name in NODES},
                recorder=self._last_status(shared, "recorder"),
                bench_dropped=transport.dropped,
                bench_sent=transport.sent,
                wire=wire,
            )

    def _last_status(self, shared: Path, name: str) -> dict[str, Any]:
        """What a process said of itself when it ended; nothing if it did not end well: counters of a
        process that was killed would be those of its start.
        """
        status = dict(read_json(shared / f"{name}.json"))
        return status if status.get("state") == "ended" and self._codes.get(name) == 0 else {}

    # -- starting -------------------------------------------------------------------------------

    def _settle_bus(self) -> BusOptions:
        """A bus that carries no other bench: the one asked for, or a free local channel."""
        bus = self._bus
        for attempt in range(2):
            mine = self._claim.take(bus)
            if mine and bus.interface == "hil":
                self._start_hub(bus)
            taken = self._who_speaks(bus) if mine else "another run of this machine"
            if not taken:
                return bus
            if self._options.channel_is_given or bus.interface != "hil" or attempt:
                raise BenchError(
                    f"{bus.interface} {bus.channel}: already carries {taken};"
                    " end that run, or choose another channel with -c"
                )
            self._end_hub()
            bus = replace(bus, channel=f"{bus.channel}-{self._options.out.name}"[:40])
        return bus

    def _start_hub(self, bus: BusOptions) -> None:
        arguments = hub_arguments(bus, self._priority("hub"))
        hub = Child("hub", "hil.canbus.local", arguments, logs=self._options.out / "logs")
        self._children["hub"] = hub
        try:
            hub.wait_for_line("ready", START_TIMEOUT_S, self._cancelled)
        except BenchError:
            if hub.returncode != 0:
                raise
            self._children.pop("hub").end()  # the channel has a hub already: join that one

    def _end_hub(self) -> None:
        if "hub" in self._children:
            self._children.pop("hub").end()

    def _who_speaks(self, bus: BusOptions) -> str:
        ours = {
            bus_identifier(codec): f"{codec.name} of another node"
            for node in ("ATO", "TCU", "ODO")
            for codec in self._contract.sent_by(node)
        }
        with Transport.open(bus, name="bench", receive=ours) as transport:
            frame = transport.receive(LISTEN_BEFORE_START_S)
        return ours.get(frame.can_id, "") if frame is not None else ""

    def _start(self, shared: Path) -> None:
        options = self._options
        scenario = options.out / "scenario.toml"
        clock = "lockstep" if options.lockstep else "realtime"
        common = ["--clock", clock, *self._bus.to_arguments()]
        if options.dbc is not None:
            common += ["--dbc", str(options.dbc)]
        properties = options.out / "properties.json"
        properties.write_text(json.dumps(recording_properties(options)), encoding="utf-8")
        common.append("--die-with-parent")
        recorder = ["--out", str(options.out), "--properties", str(properties), *common]
        recorder += ["--status", str(shared / "recorder.json"), "--tick-s", repr(options.tick_s)]
        for name in ("controller", "plant_sim"):
            recorder += ["--ring", f"{name}={shared / name}.ring"]
        for kind in options.logs:
            recorder += ["--log", kind]
        if options.view:
            recorder.append("--view")
        if options.viewer_url is not None:
            recorder += ["--viewer-url", options.viewer_url]
        self._spawn("recorder", "hil.record", recorder).wait_for_line(
            "ready", START_TIMEOUT_S, self._cancelled
        )
        for name in NODES:
            arguments = ["--scenario", str(scenario), *common]
            arguments += ["--ring", f"{shared / name}.ring", "--status", str(shared / f"{name}.json")]
            arguments += ["--tick-ns", str(options.tick_ns), "--priority", str(self._priority(name))]
            arguments += [*options.scenario.timing.arguments(), *self._placement.arguments(name)]
            self._spawn(name, name, arguments)
        for name in NODES:
            status = shared / f"{name}.json"
            self._children[name].wait_for_file(status, "state", "ready", START_TIMEOUT_S, self._cancelled)
        self._placement.keep_off(child.pid for name, child in self._children.items() if name != "controller")

    def _spawn(self, name: str, module: str, arguments: list[str]) -> Child:
        child = Child(name, module, arguments, logs=self._options.out / "logs")
        self._children[name] = child
        return child

    def _cancelled(self) -> None:
        if self._interrupted():
            raise Aborted("stopped by the user before the run began")

    def _priority(self, name: str) -> int:
        """SCHED_FIFO priority; 0 means none: in lockstep nobody waits for a deadline."""
        if self._options.priority is None or self._options.lockstep:
            return 0
        return min(max(self._options.priority + NODE_PRIORITY_OFFSET[name], 1), 98)

    # -- driving --------------------------------------------------------------------------------

    def _drive_real_time(self, bench: BenchNode) -> tuple[Ending, float]:
        start = time.monotonic()
        cut: Cut | None = None
        while True:
            now_s = time.monotonic() - start
            try:
                bench.listen()
            except BusError as error:
                return self._why(cut, Ending("died", str(error))), now_s
            view = self._watch.view(now_s)
            self._show(view, None)
            cut = cut or self._cut(now_s)
            if cut is None:
                ending = self._watch.ending(view)
                if ending is not None:
                    return ending, now_s
            elif cut.over(view, interrupts=self._interrupted()) or self._plant_is_gone():
                return cut.ending, now_s
            time.sleep(0.02)

    def _drive_lockstep(self, bench: BenchNode) -> tuple[Ending, float]:
        start = time.monotonic()
        tick, tick_s = 0, self._options.tick_s
        ticks_per_look = max(1, round(0.1 / tick_s))
        cut: Cut | None = None
        while True:
            try:
                bench.begin_tick(tick)
                while not bench.await_tick(tick, timeout_s=0.25):
                    cut = cut or self._cut(tick * tick_s)
                    if cut is not None and self._plant_is_gone():
                        return cut.ending, tick * tick_s
                    if cut is not None:
                        bench.answer_for_controller(tick)
            except BusError as error:
                return self._why(cut, Ending("died", str(error))), tick * tick_s
            tick += 1
            if tick % ticks_per_look:
                continue
            view = self._watch.view(tick * tick_s)
            self._show(view, tick * tick_s / max(time.monotonic() - start, 1e-9))
            if cut is None:
                cut = self._cut(tick * tick_s)
                if cut is not None:
                    bench.controller_is_gone = True
            ending = self._watch.ending(view) if cut is None else None
            if ending is not None:
                return ending, tick * tick_s
            if cut is not None and cut.over(view, interrupts=self._interrupted()):
                return cut.ending, tick * tick_s

    def _cut(self, now_s: float) -> Cut | None:
        """Whether the run is to be ended early, and if so, the controller with it."""
        dead, interrupts = self._died(), self._interrupted()
        if dead is None and not interrupts:
            return None
        controller = self._children["controller"]
        controller.signal(signal.SIGTERM)
        if self._options.lockstep:
            controller.wait(10.0)  # its last frames belong to this tick
        return Cut(dead or BY_THE_USER, now_s, interrupts)

    def _plant_is_gone(self) -> bool:
        """Whether nobody is left who could brake the train, or show that it stands."""
        needed = ("plant_sim", "recorder", "hub")
        return not all(self._children[name].running for name in needed if name in self._children)

    def _why(self, cut: Cut | None, otherwise: Ending) -> Ending:
        return cut.ending if cut is not None else self._died() or otherwise

    def _died(self) -> Ending | None:
        """The first process that ended by itself."""
        for name in ("hub", "plant_sim", "controller", "recorder"):
            child = self._children.get(name)
            if child is not None and not child.running:
                return Ending("died", child.last_words())
        return None

    # -- ending ---------------------------------------------------------------------------------

    def _end_everything(self) -> None:
        if not self._options.lockstep:
            # Both nodes at once, or the one that stays would report the other's silence.
            for name in NODES:
                if name in self._children:
                    self._children[name].signal(signal.SIGTERM)
        for name in ("controller", "plant_sim", "recorder", "hub"):
            child = self._children.pop(name, None)
            if child is not None:
                self._codes[name] = child.end(timeout_s=60.0 if name == "recorder" else 10.0)
