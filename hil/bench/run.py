"""One run from options to verdict: drive, judge, and leave everything on disk."""

from __future__ import annotations

import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from hil.bench.inprocess import run_in_one_process
from hil.bench.junit import write_junit
from hil.bench.loss import check_loss
from hil.bench.outcome import Interrupted, RunOptions, Show
from hil.bench.processes import run_in_processes
from hil.bench.summary import summarise
from hil.canbus.contract import Contract
from hil.record.about import add_verdict

EXIT_PASSED, EXIT_FAILED, EXIT_DIED = 0, 1, 3


def _told(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def run_scenario(options: RunOptions, *, show: Show, tell: Callable[[str], None] = _told) -> dict[str, Any]:
    """Drive a scenario and judge it; returns what summary.json holds.

    python-can's `virtual` bus joins threads of one process only, so with it the whole run stays in
    this process. Raises the errors of what could not be started; an interrupted or broken run still
    has its recording and its summary. `tell` gets a line for what went wrong with the recording at the end.
    """
    check_loss(options)
    contract = Contract.load(options.dbc)
    drive = run_in_one_process if options.bus.interface == "virtual" else run_in_processes
    with counted_interrupts() as interrupted:
        outcome = drive(options, contract, show=show, interrupted=interrupted)
        summary = summarise(options, outcome, contract)
        (options.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
        write_junit(summary, options.out / "junit.xml")
        recording = options.out / "run.rrd"
        if not outcome.recorder and not outcome.ending.because.startswith("recorder:"):
            tell(
                f"the recorder did not end well (its words: {options.out / 'logs' / 'recorder.log'});"
                f" {recording} and frames.blf hold what it had written until then"
            )
        try:
            add_verdict(recording, summary)
        except Exception as error:  # whatever it is: the run is over, and its summary is on disk
            reason = " ".join(str(error).split()) or type(error).__name__
            tell(f"the verdict is in summary.json only, not in the recording: {reason}")
    return summary


def exit_code(summary: dict[str, Any]) -> int:
    """0 passed, 1 failed or aborted, 3 something died."""
    if summary["ended"] == "died":
        return EXIT_DIED
    return EXIT_PASSED if summary["verdict"] == "passed" else EXIT_FAILED


@contextmanager
def counted_interrupts() -> Iterator[Interrupted]:
    """SIGINT and SIGTERM as a count that a loop reads, instead of an exception anywhere."""
    count = 0

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal count
        count += 1

    if threading.current_thread() is not threading.main_thread():
        yield lambda: count
        return
    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: count
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
