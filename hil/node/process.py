"""A unit as a process: command line, real-time rights, status file, and a clean end whatever happens.

`NodeProcess` is the part without signals and exit codes: the bench uses it to run a unit inside its own
process, in a thread or cycle by cycle.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

from hil.canbus.contract import Contract
from hil.canbus.transport import Transport
from hil.node import realtime
from hil.node.clock import Clock, RealTimeClock, never
from hil.node.cycle import Node, OverloadPolicy, warm_up
from hil.node.inbox import bus_identifier
from hil.node.lockstep import LockstepClock
from hil.node.options import NodeOptions, OptionsError, parse
from hil.node.rehearsal import rehearsal_of
from hil.node.spin import choose_spin
from hil.node.split import execution_split
from hil.node.timing import TimingRing
from hil.node.unit import FrameLink, Unit, UnitBuilder, default_phase_ns

__all__ = ["NodeProcess", "build_node", "main"]

UNEXPECTED = 3


def build_node(
    unit: Unit,
    transport: FrameLink,
    contract: Contract,
    *,
    clock: str = "realtime",
    ring: Path | None = None,
    tick_ns: int | None = None,
    phase_ns: int | None = None,
    spin_ns: int | None = None,
    rehearse: bool = False,
    peer_timeout_s: float = 60.0,
    overload: OverloadPolicy | None = None,
) -> Node:
    """Put a unit, an open transport and a clock together; `ring` is the file of its timing ring.

    `spin_ns` None: chosen by `hil.node.spin.choose_spin`. `rehearse`: with a twin of the unit, if it has one,
    and only where the clock spins. Raises OptionsError when the lockstep tick does not fit the unit's period.
    """
    the_clock: Clock
    try:
        if clock == "lockstep":
            the_clock = LockstepClock(
                transport, contract, unit.nodes[0], unit.after, tick_ns or unit.period_ns,
                peer_timeout_s=peer_timeout_s, period_ns=unit.period_ns,
            )  # fmt: skip
        else:
            phase = default_phase_ns(unit) if phase_ns is None else phase_ns
            spin = choose_spin(spin_ns, unit.period_ns)
            rehearsal = rehearsal_of(unit, contract) if rehearse and spin.mode != "off" else None
            the_clock = RealTimeClock(
                unit.period_ns, phase, transport=transport, spin=spin, rehearsal=rehearsal
            )
    except ValueError as error:
        if hasattr(error, "exit_code"):
            raise
        raise OptionsError(str(error)) from None
    timing = None
    if ring is not None:
        timing = TimingRing(
            ring,
            name=unit.name,
            period_ns=unit.period_ns,
            probes=unit.probes,
            clock=the_clock.kind,
            realtime_offset_ns=the_clock.realtime_offset_ns,
        )
    return Node(unit, transport, the_clock, timing, contract, overload=overload)


class NodeProcess:
    """Everything a node process does between its start and its end; a context manager.

    It warms the unit up before it opens the bus: compiling may take seconds, in which nobody would read
    what arrives. `ready()` asks for the real-time rights (`real_time=False`: none, for a thread of another
    process) and writes the status file; `run(should_stop)` cycles and always ends with safe outputs.
    """

    def __init__(self, options: NodeOptions, unit_from: UnitBuilder, *, real_time: bool = True) -> None:
        self.options = options
        self.rights = realtime.none_requested()
        self._real_time = real_time and options.clock == "realtime"
        self._resources = contextlib.ExitStack()
        contract = Contract.load(options.dbc)
        unit = unit_from(options.scenario, contract)
        self.name = options.name or unit.name
        identifiers = receive_ids(unit, contract, options.clock)
        warm_up(unit, contract)
        try:
            if options.clock == "realtime":
                self._start_helper(unit)
            self.transport = self._resources.enter_context(
                Transport.open(options.bus, name=self.name, receive=identifiers)
            )
            self.node = build_node(
                unit,
                self.transport,
                contract,
                clock=options.clock,
                ring=options.ring,
                tick_ns=options.tick_ns,
                phase_ns=options.phase_ns,
                spin_ns=options.spin_ns,
                rehearse=options.rehearse and real_time,
                peer_timeout_s=options.peer_timeout_s,
                overload=OverloadPolicy(
                    round(options.overload_grace_s * 1e9), options.max_misses, options.max_consecutive_misses
                ),
            )
            if self.node.ring is not None:
                self._resources.enter_context(self.node.ring)
        except BaseException:
            self._resources.close()
            raise

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._resources.close()

    def _start_helper(self, unit: Unit) -> None:
        """Start the unit's own helper, if it has one, before this process has real-time rights to inherit."""
        start: Callable[[], None] | None = getattr(unit, "start_helper", None)
        close: Callable[[], None] | None = getattr(unit, "close", None)
        if start is not None and close is not None:
            with realtime.kept_off(self.options.cpu):
                start()
            self._resources.callback(close)

    def ready(self) -> None:
        """Get the rights, say in the status file that the first cycle comes next."""
        if self.node.ring is not None:
            self.node.ring.touch()
        if self._real_time:
            options = self.options
            self.rights = realtime.request(options.priority, options.cpu, options.lock_memory)
        self.write_status("ready")

    def run(self, should_stop: Callable[[], bool] = never) -> None:
        """Cycle until `should_stop`; send the safe outputs then, or after an error if the bus lives."""
        try:
            self.node.run(should_stop)
        except BaseException:
            with contextlib.suppress(Exception):  # the first error is the one to report
                self.node.stop()
            raise
        self.node.stop()

    def write_status(self, state: str, **more: Any) -> None:
        """Write the status file, whole or not at all; does nothing when none was asked for."""
        if self.options.status is not None:
            document = {"state": state, "name": self.name, "pid": os.getpid(), **more}
            document |= self.node.report() | self.rights.as_dict()
            if self.options.ring is not None and state == "ended":
                document["execution_us"] = execution_split(self.options.ring)
            write_json(self.options.status, document)


def main(*, unit_from: UnitBuilder, argv: Sequence[str] | None = None) -> int:
    """Run one unit as a process until SIGTERM or SIGINT; returns the exit code.

    0: ended as asked; 2: bad input; 3: something it needs is missing or died. Every error is one line on
    standard error; HIL_TRACEBACK=1 adds the traceback of an unexpected one.
    """
    name = program_name()
    stop = _StopRequest()
    process: NodeProcess | None = None
    with stop.listening():
        try:
            options = parse(argv, program=name)
            name = options.name or name
            if options.die_with_parent:
                realtime.die_with_parent(signal.SIGTERM)
            with NodeProcess(options, unit_from) as process:
                process.ready()
                print_refused(name, process.rights)
                process.run(stop.requested)
                process.write_status("ended", exit_reason=stop.reason, exit_code=0)
            return 0
        except Exception as error:
            code = getattr(error, "exit_code", UNEXPECTED)
            line = " ".join(str(error).split()) or type(error).__name__
            if not hasattr(error, "exit_code"):
                line = f"unexpected {type(error).__name__}: {line}; HIL_TRACEBACK=1 shows where"
            print(f"{name}: {line}", file=sys.stderr, flush=True)
            if os.environ.get("HIL_TRACEBACK") == "1":
                traceback.print_exc()
            if process is not None:
                with contextlib.suppress(Exception):
                    process.write_status("ended", exit_reason=line, exit_code=code)
            return int(code)


def receive_ids(unit: Unit, contract: Contract, clock: str) -> list[int]:
    """Identifiers a node has to receive: the unit's messages, and the lockstep protocol's if it is used."""
    names = list(unit.receives)
    if clock == "lockstep":
        names += unit.after or ("SYNC",)  # who waits for answers is told by them
    contract.require(names)
    return [bus_identifier(contract.message(name)) for name in names]


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON file so that a reader sees the old one or the new one, never a part.

    Raises OptionsError when the directory does not take it.
    """
    draft = path.with_name(f"{path.name}.{os.getpid()}.new")
    try:
        draft.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        os.replace(draft, path)
    except OSError as error:
        raise OptionsError(f"status file {path}: cannot be written ({error.strerror or error})") from None


def program_name() -> str:
    """Name of the running program: `controller` for `python -m controller`."""
    started = Path(sys.argv[0])
    return started.parent.name if started.stem == "__main__" else started.stem


def print_refused(name: str, rights: realtime.RealTimeRights) -> None:
    """Tell a person at a terminal which rights are missing; a launcher reads the status file."""
    if sys.stderr.isatty():
        for right in rights.refused:
            print(f"{name}: no {right.name}: {right.detail}; {right.remedy}", file=sys.stderr)


class _StopRequest:
    """SIGTERM and SIGINT set a flag; the loop looks at it."""

    def __init__(self) -> None:
        self.reason = "stopped"
        self._requested = False

    def requested(self) -> bool:
        return self._requested

    @contextlib.contextmanager
    def listening(self) -> Any:
        """Handle the signals, and put back what handled them before."""
        before = {number: signal.signal(number, self._handle) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        del frame
        self._requested = True
        self.reason = signal.Signals(number).name
