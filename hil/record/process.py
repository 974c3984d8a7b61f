"""The recorder as a process: `python -m hil.record --out DIR … -i INTERFACE -c CHANNEL`.

It listens only. SIGTERM or SIGINT: what waits is drained, the files are finished, exit code 0. A bus that
is lost: the files are finished too, one line on standard error, exit code 3.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import NoReturn

from hil.canbus.contract import Contract
from hil.canbus.errors import BusError
from hil.canbus.transport import Transport, add_bus_arguments, options_from_namespace
from hil.node import realtime
from hil.node.process import write_json
from hil.record.dashboard import POSITION
from hil.record.errors import RecordError, ViewerUnavailable
from hil.record.log_formats import FRAME_FORMATS
from hil.record.recorder import Recorder, RecorderOptions, RecordingStats, read_properties
from hil.record.viewer import start_viewer

__all__ = ["main"]

POLL_INTERVAL_S = 0.025
QUIET_S = 0.05
"""Silence on the bus after which, when told to end, nothing more is expected to wait."""
LONGEST_DRAIN_S = 2.0
NS_PER_S = 1e9


def main(argv: Sequence[str] | None = None) -> int:
    """Record until told to end; returns the exit code."""
    stop = _Stop()
    try:
        arguments = _parser().parse_args(argv)
        if arguments.die_with_parent:
            realtime.die_with_parent(signal.SIGTERM)
        with stop:
            return _record(arguments, stop)
    except Exception as error:
        code = getattr(error, "exit_code", None)
        text = " ".join(str(error).split()) or type(error).__name__
        if code is None:
            text = f"unexpected {type(error).__name__}: {text}"
        print(f"recorder: {text}", file=sys.stderr, flush=True)
        return 3 if code is None else int(code)


def _record(arguments: argparse.Namespace, stop: _Stop) -> int:
    options = _options(arguments)
    contract = Contract.load(arguments.dbc)
    with Transport.open(options_from_namespace(arguments), name="recorder") as transport:
        recorder = Recorder(contract, options)
        lost: BusError | None = None
        try:
            _write_status(arguments.status, "ready", None)
            print("ready", flush=True)
            _run(transport, recorder, stop)
        except BusError as error:
            lost = error
        finally:
            stats = recorder.close(dropped=transport.dropped, error_frames=transport.error_frames)
            _write_status(arguments.status, "ended", stats)
        if lost is not None:
            print(
                f"recorder: {' '.join(str(lost).split())}; the recording up to then is whole", file=sys.stderr
            )
            return 3
    return 0


def _run(transport: Transport, recorder: Recorder, stop: _Stop) -> None:
    while not stop.requested:
        recorder.feed(transport.drain())
        recorder.count(dropped=transport.dropped, error_frames=transport.error_frames)
        recorder.poll()
        time.sleep(POLL_INTERVAL_S)
    deadline = time.monotonic() + LONGEST_DRAIN_S
    quiet_since = time.monotonic()
    while time.monotonic() < deadline and time.monotonic() - quiet_since < QUIET_S:
        frames = transport.drain()
        if frames:
            recorder.feed(frames)
            quiet_since = time.monotonic()
        time.sleep(QUIET_S / 10)


def _options(arguments: argparse.Namespace) -> RecorderOptions:
    rings: dict[str, Path] = {}
    for text in arguments.ring:
        name, separator, path = text.partition("=")
        if not (separator and name and path):
            raise RecordError(
                f"--ring {text}: expected NAME=FILE, for example controller=/dev/shm/controller.ring"
            )
        rings[name] = Path(path)
    viewer_url = arguments.viewer_url
    if arguments.view:
        try:
            viewer_url = start_viewer()
        except ViewerUnavailable as error:
            print(f"recorder: {error}", file=sys.stderr, flush=True)
    tick_s = arguments.tick_s
    return RecorderOptions(
        directory=arguments.out,
        clock=arguments.clock,
        tick_ns=None if tick_s is None else round(tick_s * NS_PER_S),
        rings=rings,
        properties={} if arguments.properties is None else read_properties(arguments.properties),
        position=arguments.position,
        start_ns=arguments.start_ns,
        viewer_url=viewer_url,
        logs=arguments.log,
    )


def _write_status(path: Path | None, state: str, stats: RecordingStats | None) -> None:
    if path is not None:
        write_json(path, {"state": state, "name": "recorder", **(stats.as_dict() if stats else {})})


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise RecordError(f"{message}; `python -m hil.record --help` lists the options")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="hil.record", description="Records a run from the bus.", allow_abbrev=False)
    add = parser.add_argument
    add("--out", type=Path, required=True, metavar="DIR", help="directory for run.rrd and frames.blf")
    add("--clock", choices=("realtime", "lockstep"), default="realtime", help="how time is told")
    add("--tick-s", type=float, metavar="S", help="lockstep: the tick")
    add("--start-ns", type=int, metavar="NS", help="lockstep: epoch time of tick 0; default: now")
    add(
        "--ring",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="timing ring; the first counts cycles",
    )
    add("--properties", type=Path, metavar="FILE", help="JSON object to attach to the recording")
    add("--position", default=POSITION, metavar="MESSAGE.SIGNAL", help="source of the timeline `position`")
    add("--dbc", type=Path, metavar="FILE", help="bus contract instead of the one shipped")
    add(
        "--log",
        action="append",
        default=[],
        choices=tuple(FRAME_FORMATS),
        help="write the frame log in this format too, when the run has ended; frames.blf is always there",
    )
    add("--status", type=Path, metavar="FILE", help="JSON written when ready and when ended")
    add("--view", action="store_true", help="show the run live in the Rerun viewer")
    add("--viewer-url", metavar="URL", help="send live to this Rerun server, too")
    add("--die-with-parent", action="store_true", help="end when the process that started this one ends")
    add_bus_arguments(parser)
    return parser


class _Stop:
    """SIGTERM and SIGINT set a flag; the loop looks at it."""

    def __init__(self) -> None:
        self.requested = False

    def __enter__(self) -> None:
        self._before = {
            number: signal.signal(number, self._handle) for number in (signal.SIGTERM, signal.SIGINT)
        }

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.requested = True
