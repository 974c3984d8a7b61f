"""Command line of a node process."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from hil.canbus.transport import BusOptions, add_bus_arguments, options_from_namespace

__all__ = ["NodeOptions", "OptionsError", "parse"]


class OptionsError(ValueError):
    """The command line cannot be understood."""

    exit_code = 2


@dataclass(frozen=True)
class NodeOptions:
    """What a node process is told when it starts. None: the default of the unit or of the program.

    `spin_ns` None: as the machine allows (`hil.node.spin.choose_spin`), 0: none.
    """

    scenario: Path
    bus: BusOptions
    clock: str = "realtime"
    ring: Path | None = None
    status: Path | None = None
    dbc: Path | None = None
    priority: int = 50
    cpu: int | None = None
    lock_memory: bool = True
    name: str | None = None
    phase_ns: int | None = None
    spin_ns: int | None = None
    rehearse: bool = True
    tick_ns: int | None = None
    peer_timeout_s: float = 60.0
    overload_grace_s: float = 0.2
    max_misses: int | None = None
    max_consecutive_misses: int | None = None
    die_with_parent: bool = False


class _Parser(argparse.ArgumentParser):
    """Raises OptionsError with one line instead of printing the usage and leaving."""

    def error(self, message: str) -> NoReturn:
        raise OptionsError(f"{message}; `python -m {self.prog} --help` lists the options")


def parse(arguments: Sequence[str] | None, *, program: str) -> NodeOptions:
    """Read the command line. Raises OptionsError; `--help` prints and leaves with SystemExit(0)."""
    parser = _Parser(prog=program, description=f"The node {program} on the CAN bus.", allow_abbrev=False)
    add = parser.add_argument
    add("--scenario", type=Path, required=True, metavar="FILE", help="scenario (TOML)")
    add("--clock", choices=("realtime", "lockstep"), default="realtime", help="what starts a cycle")
    add("--ring", type=Path, metavar="FILE", help="timing ring to write, best in shared memory")
    add("--status", type=Path, metavar="FILE", help="JSON written when ready and when ended")
    add("--dbc", type=Path, metavar="FILE", help="bus contract instead of the one shipped")
    add("--priority", type=_integer(0, 99), default=50, metavar="N", help="SCHED_FIFO priority, 0: none")
    add("--cpu", type=_integer(0, None), metavar="N", help="CPU to run on")
    add("--no-lock-memory", dest="lock_memory", action="store_false", help="do not lock memory")
    add("--name", help="name in messages and on the bus")
    add("--phase-ns", type=_integer(0, None), metavar="NS", help="phase of the deadlines on the grid")
    add(
        "--spin-us",
        dest="spin_ns",
        type=_spin,
        metavar="auto|N",
        help="poll the clock for the last N us before a deadline, 0: only sleep; default: auto",
    )
    add(
        "--no-rehearsal",
        dest="rehearse",
        action="store_false",
        help="do not run a twin of the unit before each deadline to warm the caches",
    )
    add("--tick-ns", type=_integer(1, None), metavar="NS", help="lockstep tick; default: the unit's period")
    add("--peer-timeout", dest="peer_timeout_s", type=_seconds, default=60.0, metavar="S",
        help="lockstep: longest silence of a peer")  # fmt: skip
    add(
        "--overload-grace",
        dest="overload_grace_s",
        type=_duration,
        default=0.2,
        metavar="S",
        help="deadlines missed so soon after the start are counted apart and never halt; default: 0.2",
    )
    add(
        "--max-misses",
        type=_integer(0, None),
        metavar="N",
        help="halt after more missed deadlines in all; default: never",
    )
    add("--max-consecutive-misses", type=_integer(0, None), metavar="N",
        help="halt after more missed deadlines in a row; default: never")  # fmt: skip
    add("--die-with-parent", action="store_true", help="end when the process that started this one ends")
    add_bus_arguments(parser)
    namespace = parser.parse_args(arguments)
    own = {field: getattr(namespace, field) for field in NodeOptions.__dataclass_fields__ if field != "bus"}
    return NodeOptions(bus=options_from_namespace(namespace), **own)


class _integer:
    """Argument type: an integer within limits."""

    def __init__(self, lowest: int, highest: int | None) -> None:
        self.lowest, self.highest = lowest, highest

    def __call__(self, text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is no integer") from None
        if value < self.lowest or (self.highest is not None and value > self.highest):
            limits = f"{self.lowest} or more" if self.highest is None else f"{self.lowest} to {self.highest}"
            raise argparse.ArgumentTypeError(f"{value} must be {limits}")
        return value


def _spin(text: str) -> int | None:
    """Nanoseconds, None for "auto"."""
    return None if text == "auto" else 1000 * _integer(0, None)(text)


def _duration(text: str) -> float:
    """Seconds, 0 allowed."""
    value = _number(text)
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} must be 0 or greater and finite")
    return value


def _seconds(text: str) -> float:
    value = _number(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} must be greater than 0 and finite")
    return value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds") from None
