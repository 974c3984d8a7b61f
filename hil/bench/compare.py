"""Contenders against each other: the nominal run of each, then the same drawn trains for all of them.

Runs go to all cores, one run a core. What is lost is said: a run that failed is counted and kept with its
reason, an interrupted comparison keeps what is there.
"""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.synchronize import Event
from pathlib import Path

from hil.bench.contender import Contender
from hil.bench.errors import BenchError
from hil.bench.outcome import Interrupted
from hil.bench.sets import NOMINAL, draws
from hil.bench.trial import Trial, TrialResult, try_out
from hil.canbus.contract import Contract

OnResult = Callable[[TrialResult], None]
LOOK_S = 0.2
"""How often the user's wish to stop is looked at."""


@dataclass(frozen=True)
class Request:
    """What to compare: `runs` draws of the set beside the nominal run, for each contender."""

    scenario: str
    contenders: tuple[Contender, ...]
    overrides: tuple[str, ...] = ()
    runs: int = 0
    set_name: str = "spec"
    seed: int = 1
    jobs: int = 0
    """Processes; 0: one for each core. With one, the runs stay in this process."""
    dbc: Path | None = None

    @property
    def total(self) -> int:
        """How many runs that makes."""
        return len(self.contenders) * (1 + self.runs)


@dataclass
class Comparison:
    """Results by contender, nominal and drawn; `interrupted` if some are missing."""

    request: Request
    nominal: dict[str, TrialResult] = field(default_factory=dict)
    drawn: dict[str, list[TrialResult]] = field(default_factory=dict)
    interrupted: bool = False

    @property
    def done(self) -> int:
        """Runs that were made."""
        return len(self.results)

    @property
    def results(self) -> list[TrialResult]:
        """All of them, the nominal ones first."""
        return [*self.nominal.values(), *(result for results in self.drawn.values() for result in results)]

    def add(self, result: TrialResult) -> None:
        """Take a result."""
        name = result.contender.name
        if result.draw.number == NOMINAL.number:
            self.nominal[name] = result
        else:
            self.drawn.setdefault(name, []).append(result)


def trials(request: Request) -> list[Trial]:
    """All runs of a comparison: the nominal ones first, then draw by draw, so that a part of them is fair."""
    plans = [
        Trial(request.scenario, request.overrides, contender, NOMINAL, keep_lines=True)
        for contender in request.contenders
    ]
    plans += [
        Trial(request.scenario, request.overrides, contender, draw)
        for draw in draws(request.set_name, request.runs, request.seed)
        for contender in request.contenders
    ]
    return plans


def compare(
    request: Request, *, on_result: OnResult = lambda result: None, interrupted: Interrupted = lambda: 0
) -> Comparison:
    """Make all runs; `on_result` hears of each as it ends. Results are in the order of the draws.

    Raises BenchError if a worker process dies.
    """
    comparison = Comparison(request)
    plans = trials(request)
    jobs = min(request.jobs or os.cpu_count() or 1, len(plans))
    run = _here if jobs <= 1 else _on_all_cores
    for result in run(request, plans, jobs, interrupted):
        comparison.add(result)
        on_result(result)
    comparison.interrupted = comparison.done < len(plans)
    _in_order(comparison)
    return comparison


def _in_order(comparison: Comparison) -> None:
    """Results come as they end; tables and files want them as they were asked for."""
    names = [contender.name for contender in comparison.request.contenders]
    comparison.nominal = {name: comparison.nominal[name] for name in names if name in comparison.nominal}
    comparison.drawn = {
        name: sorted(comparison.drawn[name], key=lambda result: result.draw.number)
        for name in names
        if name in comparison.drawn
    }


def _here(
    request: Request, plans: Sequence[Trial], jobs: int, interrupted: Interrupted
) -> Iterator[TrialResult]:
    contract = Contract.load(request.dbc)
    for plan in plans:
        if interrupted():
            return
        result = try_out(plan, contract, interrupted=interrupted)
        if result is None:
            return
        yield result


def _on_all_cores(
    request: Request, plans: Sequence[Trial], jobs: int, interrupted: Interrupted
) -> Iterator[TrialResult]:
    context = multiprocessing.get_context("spawn")  # a fork would copy locks of threads that are not copied
    stop = context.Event()
    with (
        ProcessPoolExecutor(
            jobs, mp_context=context, initializer=_begin_work, initargs=(stop, request.dbc)
        ) as pool,
        _stopped_at_the_end(stop),
    ):
        waiting: set[Future[TrialResult | None]] = set()
        left = iter(plans)
        try:
            while True:
                # no more than the cores can take at once: what waits in a queue cannot be called back
                waiting |= {
                    pool.submit(_work, plan) for plan in itertools.islice(left, 2 * jobs - len(waiting))
                }
                if not waiting:
                    return
                ready, waiting = wait(waiting, timeout=LOOK_S, return_when=FIRST_COMPLETED)
                for future in ready:
                    result = future.result()
                    if result is not None:
                        yield result
                if interrupted():
                    return
        except BrokenProcessPool:
            raise BenchError(
                "hil compare: a worker process was killed (out of memory?); try again with fewer --jobs"
            ) from None


@contextmanager
def _stopped_at_the_end(stop: Event) -> Iterator[None]:
    try:
        yield
    finally:
        stop.set()


_worker: tuple[Event, Contract]


def _begin_work(stop: Event, dbc: Path | None) -> None:
    """In a worker: Ctrl-C is for the process that started us, which then asks us to stop."""
    global _worker  # noqa: PLW0603 - one for each process, set once when it starts
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker = (stop, Contract.load(dbc))


def _work(plan: Trial) -> TrialResult | None:
    stop, contract = _worker
    asked = itertools.count(1)
    if stop.is_set():
        return None
    # asked again and again: the run ends at once, it need not brake the train to a stand
    return try_out(plan, contract, interrupted=lambda: next(asked) if stop.is_set() else 0)
