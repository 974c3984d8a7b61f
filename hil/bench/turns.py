"""Nodes that share one thread take turns, tick by tick, until the run is over: lockstep in one process."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from hil.bench.braking import BY_THE_USER, Cut
from hil.bench.outcome import Interrupted, Show
from hil.bench.sync import BenchNode
from hil.bench.watch import Ending, Watch
from hil.node.cycle import Node

NODES = ("controller", "plant_sim")
"""In the order in which they take their turns."""

BLOCK_S = 20.0
"""Simulated seconds between two calls of `each_block`: few large blocks cost a recorder least."""

LOOK_S = 0.1
"""Simulated seconds between two looks at whether the run is over."""


def _nothing() -> None:
    pass


def take_turns(
    bench: BenchNode,
    nodes: Mapping[str, Node],
    watch: Watch,
    *,
    tick_s: float,
    show: Show,
    interrupted: Interrupted,
    each_block: Callable[[], None] = _nothing,
) -> tuple[Ending, float]:
    """Run to the end; how it ended, and the simulated time [s].

    An error with an `exit_code` in a node's turn ends the run as `died`; any other passes through.
    """
    turns = [nodes[name] for name in NODES]
    look, block = max(1, round(LOOK_S / tick_s)), max(1, round(BLOCK_S / tick_s))
    tick = 0
    cut: Cut | None = None
    start = time.monotonic()
    while True:
        bench.begin_tick(tick)
        for node in turns:
            try:
                node.cycle()
            except Exception as error:
                if not hasattr(error, "exit_code"):
                    raise
                return Ending("died", f"{node.unit.name}: {error}"), tick * tick_s
        bench.await_tick(tick, timeout_s=0.0)
        tick += 1
        if tick % block == 0:
            each_block()
        if tick % look:
            continue
        view = watch.view(tick * tick_s)
        show(view, tick * tick_s / max(time.monotonic() - start, 1e-9))
        if cut is None and interrupted():
            cut = Cut(BY_THE_USER, tick * tick_s, interrupted())
            turns.pop(0).stop()
            bench.controller_is_gone = True
        ending = watch.ending(view) if cut is None else None
        if ending is not None:
            return ending, tick * tick_s
        if cut is not None and cut.over(view, interrupts=interrupted()):
            return cut.ending, tick * tick_s


@contextmanager
def garbage_collection_frozen() -> Iterator[None]:
    """As in a node's own process: what is there stays, and the loop makes no cycles to collect."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()
