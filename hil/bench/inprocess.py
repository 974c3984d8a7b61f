"""A run inside one process, asked for by the bus `-i virtual`, which joins threads of one process only.

In lockstep both nodes take turns in one thread: the fastest way to run a scenario. Nobody else can be on
that bus, so the frames pass through a `MemoryChannel` and are spared python-can's copies. In real time
each node is a thread on python-can's `virtual`; they share the interpreter, so this shows function, not
jitter.
"""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from hil.bench.outcome import Interrupted, Outcome, RunOptions, Show
from hil.bench.processes import recording_properties, shared_folder
from hil.bench.sync import LAST_IN_CHAIN, BenchNode
from hil.bench.watch import Ending, Watch
from hil.canbus.contract import Contract
from hil.canbus.memory import MemoryChannel
from hil.canbus.transport import Transport
from hil.node.cycle import Node
from hil.node.options import NodeOptions
from hil.node.process import NodeProcess, build_node, receive_ids
from hil.record.recorder import Recorder, RecorderOptions

NODES = ("controller", "plant_sim")
"""In the order in which they take their turns."""

BLOCK_S = 20.0
"""Simulated seconds between two visits of the recorder in lockstep: few large blocks cost least."""

Ended = tuple[Ending, float, float, dict[str, Mapping[str, Any]]]
"""Ending, simulated and wall-clock seconds of the loop, status by node."""


def run_in_one_process(
    options: RunOptions, contract: Contract, *, show: Show, interrupted: Interrupted
) -> Outcome:
    """Run a scenario in this process, in lockstep or in real time with one thread per node."""
    drive = _lockstep if options.lockstep else _threads
    watch = Watch(contract, time_limit_s=2.0 * options.scenario.journey.time_s + 60.0)
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
                ),
            )
        )
        ending, simulated_s, wall_s, nodes = drive(
            options, contract, watch, recorder, shared, show, interrupted
        )
        statistics = recorder.close()
        return Outcome(
            ending=ending,
            bus=options.bus,
            started=started.isoformat(timespec="milliseconds"),
            wall_time_s=wall_s,
            simulated_time_s=simulated_s,
            one_process=True,
            nodes=nodes,
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
    channel = MemoryChannel()
    last = contract.message(LAST_IN_CHAIN).can_id
    bench = BenchNode(channel.link([*watch.identifiers, last]), contract, watch, tick_s=options.tick_s)
    listener = channel.link()
    nodes = {name: _node(options, contract, channel, name, shared) for name in NODES}
    controller, plant = (nodes[name] for name in NODES)
    tick_s = options.tick_s
    look, block = max(1, round(0.1 / tick_s)), max(1, round(BLOCK_S / tick_s))
    tick = 0
    ending: Ending | None = None
    with _garbage_collection_frozen():
        start = time.monotonic()
        while ending is None:
            bench.begin_tick(tick)
            controller.cycle()
            plant.cycle()
            bench.await_tick(tick, timeout_s=0.0)
            tick += 1
            if tick % block == 0:
                recorder.feed(listener.drain())
                recorder.flush()
            if tick % look == 0:
                view = watch.view(tick * tick_s)
                show(view, tick * tick_s / max(time.monotonic() - start, 1e-9))
                ending = watch.ending(view)
                if ending is None and interrupted():
                    ending = Ending("aborted", "stopped by the user")
        for node in nodes.values():
            node.stop()
        recorder.feed(listener.drain())
        recorder.flush()
        wall_s = time.monotonic() - start
    return ending, tick * tick_s, wall_s, {name: node.report() for name, node in nodes.items()}


@contextmanager
def _garbage_collection_frozen() -> Iterator[None]:
    """As in a node's own process: what is there stays, and the loop makes no cycles to collect."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


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
    stop = threading.Event()
    failures: list[str] = []

    def drive(node: NodeProcess) -> None:
        try:
            node.run(stop.is_set)
        except Exception as error:  # told by the main thread, in one line
            failures.append(f"{node.name}: {error}")

    with ExitStack() as stack:
        transport = stack.enter_context(Transport.open(options.bus, name="bench"))
        listener = stack.enter_context(Transport.open(options.bus, name="recorder"))
        bench = BenchNode(transport, contract, watch, tick_s=options.tick_s)
        nodes = {
            name: stack.enter_context(
                NodeProcess(_node_options(options, name, shared), units[name], real_time=False)
            )
            for name in NODES
        }
        for node in nodes.values():
            node.ready()
        threads = [threading.Thread(target=drive, args=(node,), name=name) for name, node in nodes.items()]
        for thread in threads:
            thread.start()
        start = time.monotonic()
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
                ending = watch.ending(view)
                if failures:
                    ending = Ending("died", failures[0])
                elif interrupted():
                    ending = Ending("aborted", "stopped by the user")
                time.sleep(0.02)
        finally:
            stop.set()
            for thread in threads:
                thread.join()
            recorder.feed(listener.drain())
        wall_s = time.monotonic() - start
        reports: dict[str, Mapping[str, Any]] = {
            name: {**node.node.report(), **node.rights.as_dict()} for name, node in nodes.items()
        }
        recorder.flush()  # while the rings are still there
        return ending, now_s, wall_s, reports


def _node_options(options: RunOptions, name: str, shared: Path) -> NodeOptions:
    """What a node is told when it is a thread of this process."""
    return NodeOptions(
        scenario=options.out / "scenario.toml",
        bus=options.bus,
        ring=shared / f"{name}.ring",
        dbc=options.dbc,
        priority=0,
        lock_memory=False,
        name=name,
        spin_ns=0,  # a spinning thread would hold the interpreter that the other needs
    )
