"""A run as separate processes on one bus: hub, recorder, plant, controller, and this launcher.

The launcher is the node BENCH. It starts the others in the order in which they are needed, watches
them, and ends them in the order in which they can be missed: the controller first, so that the
plant still brakes the train, and the recorder after both, so that it hears their last words.
"""

from __future__ import annotations

import json
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hil.bench.children import Child, read_json
from hil.bench.errors import BenchError
from hil.bench.outcome import Interrupted, Outcome, RunOptions, Show
from hil.bench.sync import BenchNode
from hil.bench.watch import Ending, Watch
from hil.canbus.contract import Contract
from hil.canbus.errors import BusError
from hil.canbus.transport import BusOptions, Transport

START_TIMEOUT_S = 60.0
"""A node compiles its numeric kernels on its first start; later starts take a second or two."""

BRAKING_LIMIT_S = 90.0
"""How long a train may take to come to a stand after its controller was stopped or died."""

LAST_FRAMES_S = 0.5
"""Time for the frames that say that the train stands to reach the recorder."""

NODES = ("plant_sim", "controller")
NODE_PRIORITY_OFFSET = {"hub": 10, "controller": 0, "plant_sim": -5}
"""SCHED_FIFO order: the bus before the controller before the plant, as wires are faster than units."""

LISTEN_BEFORE_START_S = 0.25
"""Longer than the slowest cycle of the bench's own messages (100 ms): who is there, is heard."""


def run_in_processes(
    options: RunOptions, contract: Contract, *, show: Show, interrupted: Interrupted
) -> Outcome:
    """Run a scenario in separate processes, in real time or in lockstep.

    Raises BenchError or BusError if something cannot be started; whatever ends the run after that
    is in the outcome.
    """
    return _ProcessRun(options, contract, show, interrupted).run()


class _ProcessRun:
    def __init__(self, options: RunOptions, contract: Contract, show: Show, interrupted: Interrupted) -> None:
        self._options = options
        self._contract = contract
        self._show = show
        self._interrupted = interrupted
        self._children: dict[str, Child] = {}
        self._bus = options.bus
        timetable_s = options.scenario.journey.time_s
        self._watch = Watch(contract, time_limit_s=2.0 * timetable_s + 60.0)

    def run(self) -> Outcome:
        with ExitStack() as stack:
            shared = stack.enter_context(shared_folder())
            stack.callback(self._end_everything)
            self._bus = self._settle_bus()
            done = self._contract.message("TCU_SyncDone").can_id
            transport = stack.enter_context(
                Transport.open(self._bus, name="bench", receive=[*self._watch.identifiers, done])
            )
            bench = BenchNode(transport, self._contract, self._watch, tick_s=self._options.tick_s)
            self._start(shared)
            started = datetime.now(UTC)
            clock = time.monotonic()
            if self._options.lockstep:
                ending, simulated_s = self._drive_lockstep(bench)
            else:
                ending, simulated_s = self._drive_real_time(bench)
            wall_s = time.monotonic() - clock
            self._end_everything()
            return Outcome(
                ending=ending,
                bus=self._bus,
                started=started.isoformat(timespec="milliseconds"),
                wall_time_s=wall_s,
                simulated_time_s=simulated_s,
                one_process=False,
                nodes={name: read_json(shared / f"{name}.json") for name in NODES},
                recorder=read_json(shared / "recorder.json"),
                bench_dropped=transport.dropped,
            )

    # -- starting -------------------------------------------------------------------------------

    def _settle_bus(self) -> BusOptions:
        """A bus that carries no other bench: the one asked for, or a free local channel."""
        bus = self._bus
        for attempt in range(2):
            if bus.interface == "hil":
                self._start_hub(bus)
            taken = self._who_speaks(bus)
            if not taken:
                return bus
            if self._options.channel_is_given or bus.interface != "hil" or attempt:
                raise BenchError(
                    f"{bus.interface} {bus.channel}: already carries {taken} from another node;"
                    " end that run, or choose another channel with -c"
                )
            self._end_hub()
            bus = replace(bus, channel=f"{bus.channel}-{self._options.out.name}"[:40])
        return bus

    def _start_hub(self, bus: BusOptions) -> None:
        arguments = ["--channel", bus.channel, "--parent-pipe"]
        if self._priority("hub"):
            arguments += ["--priority", str(self._priority("hub"))]
        hub = Child("hub", "hil.canbus.local", arguments, logs=self._options.out / "logs")
        self._children["hub"] = hub
        try:
            hub.wait_for_line("ready", START_TIMEOUT_S)
        except BenchError:
            if hub.returncode != 0:
                raise
            self._children.pop("hub").end()  # the channel has a hub already: join that one

    def _end_hub(self) -> None:
        if "hub" in self._children:
            self._children.pop("hub").end()

    def _who_speaks(self, bus: BusOptions) -> str:
        ours = {
            codec.can_id: codec.name
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
        recorder = ["--out", str(options.out), "--properties", str(properties), *common]
        recorder += ["--status", str(shared / "recorder.json"), "--tick-s", repr(options.tick_s)]
        for name in ("controller", "plant_sim"):
            recorder += ["--ring", f"{name}={shared / name}.ring"]
        if options.view:
            recorder.append("--view")
        self._spawn("recorder", "hil.record", recorder).wait_for_line("ready", START_TIMEOUT_S)
        for name in NODES:
            arguments = ["--scenario", str(scenario), "--die-with-parent", *common]
            arguments += ["--ring", f"{shared / name}.ring", "--status", str(shared / f"{name}.json")]
            arguments += ["--tick-ns", str(options.tick_ns), "--priority", str(self._priority(name))]
            self._spawn(name, name, arguments)
        for name in NODES:
            self._children[name].wait_for_file(shared / f"{name}.json", "state", "ready", START_TIMEOUT_S)

    def _spawn(self, name: str, module: str, arguments: list[str]) -> Child:
        child = Child(name, module, arguments, logs=self._options.out / "logs")
        self._children[name] = child
        return child

    def _priority(self, name: str) -> int:
        """SCHED_FIFO priority; 0 means none: in lockstep nobody waits for a deadline."""
        if self._options.priority is None or self._options.lockstep:
            return 0
        return min(max(self._options.priority + NODE_PRIORITY_OFFSET[name], 1), 98)

    # -- driving --------------------------------------------------------------------------------

    def _drive_real_time(self, bench: BenchNode) -> tuple[Ending, float]:
        start = time.monotonic()
        cut: Ending | None = None  # the controller is gone: the plant brakes the train by itself
        cut_at_s = 0.0
        while True:
            now_s = time.monotonic() - start
            try:
                bench.listen()
            except BusError as error:
                return cut or self._died() or Ending("died", str(error)), now_s
            view = self._watch.view(now_s)
            self._show(view, None)
            dead = self._died()
            if dead is not None and self._children["controller"].running:
                return dead, now_s
            if cut is None and (dead is not None or self._interrupted()):
                cut, cut_at_s = dead or Ending("aborted", "stopped by the user"), now_s
                self._children["controller"].signal(signal.SIGTERM)
            ending = self._watch.ending(view, controlled=cut is None)
            if cut is None and ending is not None:
                return ending, now_s
            if cut is not None and (self._stands(view.standstill, now_s - cut_at_s) or self._given_up(cut)):
                return cut, now_s
            time.sleep(0.02)

    def _stands(self, standstill: bool, since_cut_s: float) -> bool:
        """Whether the wait for a train without controller is over: it stands, or never will."""
        witnesses = (child for name, child in self._children.items() if name != "controller")
        settled = standstill and since_cut_s > LAST_FRAMES_S
        return settled or since_cut_s > BRAKING_LIMIT_S or not all(child.running for child in witnesses)

    def _given_up(self, cut: Ending) -> bool:
        return self._interrupted() > (1 if cut.how == "aborted" else 0)

    def _drive_lockstep(self, bench: BenchNode) -> tuple[Ending, float]:
        start = time.monotonic()
        tick, tick_s = 0, self._options.tick_s
        ticks_per_look = max(1, round(0.1 / tick_s))
        while True:
            now_s = tick * tick_s
            try:
                bench.begin_tick(tick)
                while not bench.await_tick(tick, timeout_s=0.25):
                    dead = self._died()
                    if dead is not None:
                        return dead, now_s
                    if self._interrupted():
                        return Ending("aborted", "stopped by the user"), now_s
            except BusError as error:
                return self._died() or Ending("died", str(error)), now_s
            tick += 1
            if tick % ticks_per_look:
                continue
            view = self._watch.view(tick * tick_s)
            self._show(view, tick * tick_s / max(time.monotonic() - start, 1e-9))
            ending = self._watch.ending(view) or self._died()
            if ending is None and self._interrupted():
                ending = Ending("aborted", "stopped by the user")
            if ending is not None:
                return ending, tick * tick_s

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
                child.end(timeout_s=60.0 if name == "recorder" else 10.0)


def recording_properties(options: RunOptions) -> dict[str, Any]:
    """What a recording says of itself beside its signals."""
    journey = options.scenario.journey
    return {
        "scenario": options.scenario.name,
        "title": options.scenario.title,
        "law": options.scenario.law,
        "seed": journey.seed,
        "mode": options.mode,
        "line": journey.line.name,
        "train": journey.train.name,
        "origin_m": journey.origin.position_m,
        "destination_m": journey.destination.position_m,
        "timetable_s": journey.time_s,
    }


@contextmanager
def shared_folder() -> Iterator[Path]:
    """A folder in memory for rings and status files, gone when the run is."""
    memory = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(prefix="hil-", dir=memory if memory.is_dir() else None))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
