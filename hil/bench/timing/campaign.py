"""The measurement: conditions, rounds and parts in their order, and everything that was learned meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial

from hil.bench.errors import Aborted
from hil.bench.outcome import Interrupted
from hil.bench.timing.cyclictest import MISSING, Cyclictest
from hil.bench.timing.full import measure_full
from hil.bench.timing.host import Host, cpu_times, read_host, realtime_processes, rights_of
from hil.bench.timing.load import busy
from hil.bench.timing.loop import measure_loop
from hil.bench.timing.request import FULL, FULL_ALONE, LOOP_PLAIN, LOOP_SPIN, PEER, TITLES, TimingRequest
from hil.bench.timing.samples import Measured, Slice, merged
from hil.canbus.contract import Contract

__all__ = ["Campaign", "Show", "measure", "seconds_needed"]

Show = Callable[[float, str], None]
"""Called with the seconds that are done and what is measured now."""

START_S = {FULL: 8.0, FULL_ALONE: 7.0, LOOP_PLAIN: 1.0, LOOP_SPIN: 1.0, PEER: 0.1}
"""What starting and ending a part takes beside its slice; for the progress bar only."""


@dataclass(frozen=True)
class Campaign:
    """All that was measured, by condition and part."""

    request: TimingRequest
    host: Host
    peer: Cyclictest | None
    measured: Mapping[tuple[str, str], Measured]
    busy_share: Mapping[str, float]
    steal_share: Mapping[str, float]
    load: str
    competitors: frozenset[str] = frozenset()  # other real-time processes that ran
    notes: tuple[str, ...] = field(default=())

    @property
    def fifo(self) -> bool:
        """Whether everything ran under SCHED_FIFO."""
        return rights_of(self.request, self.host)[0]


def seconds_needed(request: TimingRequest) -> float:
    """About how long the measurement takes, starting and ending of the parts included [s]."""
    one_round = sum(request.slice_s + START_S[part] for part in request.parts)
    return one_round * request.slices * len(request.conditions)


def measure(request: TimingRequest, contract: Contract, *, show: Show, interrupted: Interrupted) -> Campaign:
    """Measure everything that was asked for. Raises BenchError or BusError, Aborted if the user stops it."""
    host = read_host()
    fifo, lock = rights_of(request, host)
    peer = Cyclictest.find(fifo=fifo, lock_memory=lock)
    notes = [MISSING] if peer is None else []
    refusal = peer.refusal() if peer is not None else ""
    if refusal:
        notes.append(f"cyclictest does not run here, so no ratios and no witness; it says: {refusal}")
        peer = None
    if peer is not None and not peer.has_spikes:
        notes.append(f"cyclictest {peer.version} has no --spike: no witness (rt-tests 2.0 or newer has it)")
    parts = [part for part in request.parts if part != PEER or peer is not None]
    slices: dict[tuple[str, str], list[Slice]] = {}
    busy_share: dict[str, float] = {}
    steal_share: dict[str, float] = {}
    competitors: frozenset[str] = frozenset()
    done, number, load = 0.0, 0, ""
    for condition in request.conditions:
        with busy() if condition == "load" else nullcontext("") as told:
            load = told or load
            before = cpu_times()
            for turn in request.turns(condition):
                for part in (part for part in turn if part in parts):
                    number += 1
                    competitors |= realtime_processes()
                    takes = request.slice_s + START_S[part]
                    waiting = partial(
                        _tell, show, interrupted, done, takes, time.monotonic(), _where(part, condition)
                    )
                    piece = _slice(request, contract, peer, part, number, waiting)
                    slices.setdefault((condition, part), []).append(piece)
                    done += takes
            busy_share[condition], steal_share[condition] = cpu_times().shares_since(before)
    ordered = {key: slices[key] for key in _order(request) if key in slices}
    return Campaign(
        request, host, peer, merged(ordered), busy_share, steal_share, load, competitors, tuple(notes)
    )


def _slice(
    request: TimingRequest,
    contract: Contract,
    peer: Cyclictest | None,
    part: str,
    number: int,
    waiting: Callable[[], None],
) -> Slice:
    cycles = max(10, round(request.slice_s / request.period_s))
    if part == PEER and peer is not None:
        return peer.measure(
            period_ns=request.period_ns,
            cycles=cycles,
            priority=request.priority,
            cpu=request.cpu,
            waiting=waiting,
        )
    if part in (LOOP_PLAIN, LOOP_SPIN):
        return measure_loop(
            period_ns=request.period_ns,
            cycles=cycles,
            spin_ns=0 if part == LOOP_PLAIN else request.spin_ns,
            priority=request.priority,
            cpu=request.cpu,
            waiting=waiting,
        )
    return measure_full(request, contract, peer, recorder=part == FULL, number=number, waiting=waiting)


def _tell(show: Show, interrupted: Interrupted, done: float, takes: float, since: float, what: str) -> None:
    if interrupted():
        raise Aborted("stopped by the user; a measurement that is not whole is not judged")
    show(done + min(takes, time.monotonic() - since), what)


def _where(part: str, condition: str) -> str:
    return TITLES[part] + (", every core busy" if condition == "load" else "")


def _order(request: TimingRequest) -> list[tuple[str, str]]:
    return [(condition, part) for condition in request.conditions for part in TITLES]
