"""A run inside one process, asked for by the bus `-i virtual`, which joins threads of one process only.

In lockstep both nodes take turns in one thread: the fastest way to run a scenario. Nobody else can be on
that bus, so the frames pass through a `MemoryChannel` and are spared python-can's copies. In real time
each node is a thread on python-can's `virtual`; they share the interpreter, so this shows function, not
jitter.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from datetime import UTC, datetime
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple

from hil.bench.braking import BY_THE_USER, Cut
from hil.bench.loss import frame_loss
from hil.bench.outcome import Interrupted, Outcome, RunOptions, Show
from hil.bench.recording_properties import recording_properties
from hil.bench.shared import shared_folder
from hil.bench.sync import LAST_IN_CHAIN, BenchNode
from hil.bench.turns import NODES, garbage_collection_frozen, take_turns
from hil.bench.watch import Ending, Watch
from hil.canbus.contract import Contract
from hil.canbus.memory import MemoryChannel
from hil.canbus.transport import Transport
from hil.node.cycle import Node
from hil.node.inbox import bus_identifier
from hil.node.options import NodeOptions
from hil.node.process import NodeProcess, build_node, receive_ids
from hil.record.recorder import Recorder, RecorderOptions
from hil.record.viewer import start_viewer


class Ended(NamedTuple):
    """How the loop ended: its simulated and wall-clock time, status by node, frames that the bench sent."""

    ending: Ending
    simulated_s: float
    wall_s: float
    nodes: Mapping[str, Mapping[str, Any]]
    bench_sent: int
    lost_on_purpose: int = 0


def run_in_one_process(
    options: RunOptions, contract: Contract, *, show: Show, interrupted: Interrupted
) -> Outcome:
    """Run a scenario in this process, in lockstep or in real time with one thread per node."""
    drive = _lockstep if options.lockstep else _threads
    watch = Watch(contract, time_limit_s=options.time_limit_s)
    started = datetime.now(UTC)
    with ExitStack() as stack:
        shared = stack.enter_context(shared_folder())
        recorder = stack.enter_context(
            Recorder(
                contract,
                RecorderOptions(
                    directory=options.out,
                    clock="lockstep" if options.lockstep else "realtime",
                    tick_ns=options.tick_ns,
                    rings={name: shared / f"{name}.ring" for name in NODES},
                    properties=recording_properties(options),
                    logs=options.logs,
                    viewer_url=start_viewer() if options.view else options.viewer_url,
                ),
            )
        )
        ended = drive(options, contract, watch, recorder, shared, show, interrupted)
        statistics = recorder.close()
        return Outcome(
            ending=ended.ending,
            bus=options.bus,
            started=started.isoformat(timespec="milliseconds"),
            wall_time_s=ended.wall_s,
            simulated_time_s=ended.simulated_s,
            one_process=True,
            nodes=ended.nodes,
            bench_sent=ended.bench_sent,
            lost_on_purpose=ended.lost_on_purpose,
            recorder=statistics.as_dict(),
        )


def _lockstep(
    options: RunOptions,
    contract: Contract,
    watch: Watch,
    recorder: Recorder,
    shared: Path,
    show: Show,
    interrupted: Interrupted,
) -> Ended:
    scenario = options.scenario
    channel = MemoryChannel(frame_loss(contract, scenario.bus.loss_probability, scenario.journey.seed))
    last = bus_identifier(contract.message(LAST_IN_CHAIN))
    link = channel.link([*watch.identifiers, last])
    bench = BenchNode(link, contract, watch, tick_s=options.tick_s)
    listener = channel.link()
    nodes = {name: _node(options, contract, channel, name, shared) for name in NODES}

    def record() -> None:
        recorder.feed(listener.drain())
        recorder.flush()

    with garbage_collection_frozen():
        start = time.monotonic()
        ending, simulated_s = take_turns(
            bench, nodes, watch,
            tick_s=options.tick_s, show=show, interrupted=interrupted, each_block=record,
        )  # fmt: skip
        for name, node in nodes.items():
            if name != "controller" or not bench.controller_is_gone:
                node.stop()
        record()
        wall_s = time.monotonic() - start
    reports = {name: node.report() for name, node in nodes.items()}
    return Ended(ending, simulated_s, wall_s, reports, link.sent, channel.lost)


def _node(options: RunOptions, contract: Contract, channel: MemoryChannel, name: str, shared: Path) -> Node:
    build = next(entry for entry in entry_points(group="hil.node.unit") if entry.name == name).load()
    unit = build(options.out / "scenario.toml", contract)
    node = build_node(
        unit,
        channel.link(receive_ids(unit, contract, "lockstep")),
        contract,
        clock="lockstep",
        ring=shared / f"{name}.ring",
        tick_ns=options.tick_ns,
    )
    node.warm_up()
    return node


def _threads(
    options: RunOptions,
    contract: Contract,
    watch: Watch,
    recorder: Recorder,
    shared: Path,
    show: Show,
    interrupted: Interrupted,
) -> Ended:
    units = {entry.name: entry.load() for entry in entry_points(group="hil.node.unit")}
    with ExitStack() as stack:
        transport = stack.enter_context(Transport.open(options.bus, name="bench"))
        listener = stack.enter_context(Transport.open(options.bus, name="recorder"))
        bench = BenchNode(transport, contract, watch, tick_s=options.tick_s)
        threads: dict[str, _NodeThread] = {}
        for name in NODES:
            process = stack.enter_context(
                NodeProcess(_node_options(options, name, shared), units[name], real_time=False)
            )
            process.ready()
            threads[name] = _NodeThread(process)
        for thread in threads.values():
            thread.start()
        start = time.monotonic()
        cut: Cut | None = None
        ending: Ending | None = None
        now_s = 0.0
        try:
            while ending is None:
                now_s = time.monotonic() - start
                bench.listen()
                recorder.feed(listener.drain())
                recorder.poll()
                view = watch.view(now_s)
                show(view, None)
                failed = next((thread.failure for thread in threads.values() if thread.failure), None)
                if cut is None and (failed or interrupted()):
                    cut = Cut(Ending("died", failed) if failed else BY_THE_USER, now_s, interrupted())
                    threads["controller"].ask_to_stop()
                if cut is None:
                    ending = watch.ending(view)
                elif cut.over(view, interrupts=interrupted()) or threads["plant_sim"].failure:
                    ending = cut.ending
                time.sleep(0.02)
        finally:
            for thread in threads.values():
                thread.ask_to_stop()
            for thread in threads.values():
                thread.join()
            recorder.feed(listener.drain())
        wall_s = time.monotonic() - start
        reports: dict[str, Mapping[str, Any]] = {
            name: {**thread.process.node.report(), **thread.process.rights.as_dict()}
            for name, thread in threads.items()
        }
        recorder.flush()  # while the rings are still there
        return Ended(ending, now_s, wall_s, reports, transport.sent)


class _NodeThread(threading.Thread):
    """A node as a thread; `failure` is what it died of, told by the main thread in one line."""

    def __init__(self, process: NodeProcess) -> None:
        super().__init__(name=process.name)
        self.process = process
        self.failure: str | None = None
        self._stop_asked = threading.Event()

    def ask_to_stop(self) -> None:
        self._stop_asked.set()

    def run(self) -> None:
        try:
            self.process.run(self._stop_asked.is_set)
        except Exception as error:
            self.failure = f"{self.process.name}: {error}"


def _node_options(options: RunOptions, name: str, shared: Path) -> NodeOptions:
    """What a node is told when it is a thread of this process: of `[timing]` what an overload does."""
    timing = options.scenario.timing
    return NodeOptions(
        scenario=options.out / "scenario.toml",
        bus=options.bus,
        ring=shared / f"{name}.ring",
        dbc=options.dbc,
        priority=0,
        lock_memory=False,
        name=name,
        spin_ns=0,  # a spinning thread would hold the interpreter that the other needs
        overload_grace_s=timing.startup_grace_s,
        max_misses=timing.max_overloads,
        max_consecutive_misses=timing.max_consecutive_overloads,
    )
