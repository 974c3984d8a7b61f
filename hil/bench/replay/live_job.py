"""A recorded log put to a device on a bus: bus made ready, device started or awaited, its answers judged."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.bench.children import Child
from hil.bench.errors import Aborted, BenchError
from hil.bench.outcome import Interrupted
from hil.bench.processes import NODE_PRIORITY_OFFSET
from hil.bench.replay.comparison import compare
from hil.bench.replay.job import (
    REPLAYABLE,
    SCENARIO_FILE,
    LiveFigures,
    Replayed,
    ReplayRequest,
    Show,
    load_unit,
)
from hil.bench.replay.live import Due, Live, Silent, play_live
from hil.bench.replay.recorded import Place, Recorded, ReplayError, find_log, read_recorded
from hil.bench.replay.restbus import Said
from hil.bench.replay.rules import LIVE_STEPS, load_rules
from hil.bench.rights import keeping_time
from hil.bench.scenario import Scenario
from hil.bench.shared import BusClaim
from hil.bench.wire import hub_arguments
from hil.canbus.codec import MessageCodec
from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.canbus.options import LOCAL_INTERFACE, BusOptions
from hil.canbus.transport import Transport
from hil.node.inbox import bus_identifier
from hil.node.start_limit import start_limit_s

__all__ = ["LiveOptions", "replay_live"]

NS_PER_S = 1e9
LISTEN_BEFORE_START_S = 0.25
"""Longer than the slowest cycle of the bench's own messages (100 ms): a unit that is still there is heard."""

NEIGHBOURS = 2
"""The device's cycles lie elsewhere between the frames of the restbus than in the recording."""


@dataclass(frozen=True)
class LiveOptions:
    """How to play live. `start_node`: start our own node as the device. `until_s`: play so much of the
    recording (None: all). `settle_s`: what deviates so soon after the device's first cycle does not count.
    `wait_s`: longest silence of the device before its first cycle (None: 10 s, or what our node may take).
    `priority`: SCHED_FIFO priority of our node, and about that of hub and restbus (0: none asks).
    """

    bus: BusOptions
    start_node: bool = False
    until_s: float | None = None
    settle_s: float = 1.0
    wait_s: float | None = None
    priority: int = 50


class _Device(NamedTuple):
    """Who is replaced: name, its DBC nodes, the scenario (not needed for a device that is there)."""

    name: str
    nodes: tuple[str, ...]
    scenario: Scenario | None
    file: Path | None


def replay_live(
    request: ReplayRequest,
    options: LiveOptions,
    *,
    show: Show = lambda share: None,
    tell: Callable[[str], None] = lambda line: None,
    interrupted: Interrupted = lambda: 0,
) -> Replayed:
    """Send on a bus what the others said in the recording, when they said it; compare the device's answers.

    A user's interrupt ends it early; what was played until then is compared. Raises ReplayError and the
    errors of a scenario, a contract or a log that is wrong; BusError when the bus cannot be opened or ends;
    BenchError when the device does not speak, ends, or somebody else plays a node of the restbus.
    """
    contract = Contract.load(request.dbc)
    place = find_log(request.log)
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hil-")))
        device = _device(request, options, place, contract, scratch)
        recorded = read_recorded(place.log, contract, device.nodes)
        if recorded.lockstep:
            raise ReplayError(
                f"{place.log}: recorded in lockstep, where frames have no time of their own;"
                " for --live record it in real time (hil run without --lockstep)"
            )
        rules = load_rules(request.rules, request.tolerances, request.ignore, contract)
        codecs = [codec for node in device.nodes for codec in contract.sent_by(node)]
        plan = _plan(recorded, codecs, options, place)
        begin = time.monotonic()
        live, dropped = _play(stack, scratch, device, codecs, plan, options, show, tell, interrupted)
        wall_s = time.monotonic() - begin
    settle_ns = round(options.settle_s * NS_PER_S)
    if live.played_ns <= settle_ns:  # only when interrupted: the plan is longer
        raise Aborted(
            f"stopped by the user after {live.played_ns / NS_PER_S:.1f} s, before anything was to be compared"
            f" (--settle {options.settle_s:g})"
        )
    rules = rules.with_default(LIVE_STEPS)
    comparison = compare(
        codecs,
        plan.own,
        live.said,
        rules,
        event_window_ns=2 * plan.period_ns,
        neighbours=NEIGHBOURS,
        span_ns=(settle_ns, live.played_ns),
    )
    late_us = np.percentile(np.array(live.late_ns or [0]) / 1e3, [50, 99, 100])
    return Replayed(
        place=place,
        scenario=device.scenario,
        node=device.name,
        lockstep=False,
        instants="the device's own clock",
        cycles=sum(said.can_id == plan.anchor for said in live.said),
        duration_s=live.played_ns / NS_PER_S,
        wall_s=wall_s,
        restbus_frames=len(live.late_ns),
        left_out=recorded.left_out,
        rules=rules,
        comparison=comparison,
        live=LiveFigures(
            bus=str(options.bus),
            late_p50_us=float(late_us[0]),
            late_p99_us=float(late_us[1]),
            late_max_us=float(late_us[2]),
            settle_s=options.settle_s,
            dropped=dropped,
            stopped=live.stopped,
        ),
    )


def _device(
    request: ReplayRequest, options: LiveOptions, place: Place, contract: Contract, scratch: Path
) -> _Device:
    """What is under test. Raises ReplayError."""
    name = request.node
    if name not in REPLAYABLE:
        if name not in contract.nodes:
            known = ", ".join([*REPLAYABLE, *contract.nodes])
            raise ReplayError(f"--node {name}: no such node; there are {known}")
        if options.start_node:
            raise ReplayError(f"--start-node: only {' and '.join(REPLAYABLE)} can be started, not {name}")
        return _Device(name, (name,), None, None)
    scenario, unit = load_unit(request, place, contract, scratch, ", or name a node of the DBC with --node")
    return _Device(name, unit.nodes, scenario, scratch / SCENARIO_FILE)


class _Plan(NamedTuple):
    """The recording as it is to be played: times in ns after the device's first cycle.

    `anchor`: the message whose first frame is that cycle; `period_ns`: its cycle time; `until_ns`: the end.
    """

    restbus: Sequence[Due]
    own: Sequence[Said]
    anchor: int
    period_ns: int
    until_ns: int


def _plan(recorded: Recorded, codecs: Sequence[MessageCodec], options: LiveOptions, place: Place) -> _Plan:
    alive = [frame for at, frame in recorded.own if recorded.ended is None or at < recorded.ended]
    if not alive:
        raise ReplayError(f"{place.log}: the node ends before it has said anything; nothing to compare")
    said = {frame.can_id for frame in alive}
    cyclic = [c for c in codecs if c.cycle_ns is not None and bus_identifier(c) in said]
    if cyclic:
        fastest = min(cyclic, key=lambda codec: (codec.cycle_ns or 0, codec.can_id))
        anchor, period_ns = bus_identifier(fastest), fastest.cycle_ns or 0
    else:
        anchor, period_ns = alive[0].can_id, 0
    zero_ns = next(frame for frame in alive if frame.can_id == anchor).timestamp_ns
    # What was said before the device was on the bus, it has not heard.
    present_from_ns = alive[0].timestamp_ns
    restbus = [
        Due(frame.timestamp_ns - zero_ns, frame.can_id, frame.data)
        for _, frame in recorded.others
        if frame.timestamp_ns >= present_from_ns
    ]
    own = [Said(frame.timestamp_ns - zero_ns, frame.can_id, frame.data) for frame in alive]
    until_ns = min(own[-1].time_ns, restbus[-1].due_ns if restbus else own[-1].time_ns)
    if options.until_s is not None:
        until_ns = min(until_ns, round(options.until_s * NS_PER_S))
    if until_ns <= options.settle_s * NS_PER_S:
        raise ReplayError(
            f"{max(until_ns, 0) / NS_PER_S:.2f} s of the recording to play, of which the first"
            f" {options.settle_s:g} s do not count: nothing to compare (--settle, --until)"
        )
    return _Plan(restbus, own, anchor, period_ns, until_ns)


def _play(
    stack: ExitStack,
    scratch: Path,
    device: _Device,
    codecs: Sequence[MessageCodec],
    plan: _Plan,
    options: LiveOptions,
    show: Show,
    tell: Callable[[str], None],
    interrupted: Interrupted,
) -> tuple[Live, int]:
    """Everything on the bus; what was heard, and how many frames the bus says it lost."""
    bus = options.bus
    children: list[Child] = []

    def should_stop() -> bool:
        for child in children:
            if not child.running:
                raise BenchError(child.last_words())
        return interrupted() > 0

    claim = BusClaim()
    stack.callback(claim.release)
    if not claim.take(bus):
        raise BenchError(
            f"{bus}: already driven by another bench of this machine; end it, or take another -c"
        )
    if bus.interface == LOCAL_INTERFACE:
        priority = options.priority + NODE_PRIORITY_OFFSET["hub"] if options.priority else 0
        hub = Child("hub", "hil.canbus.local", hub_arguments(bus, priority), logs=scratch)
        stack.callback(hub.end)
        try:
            hub.wait_for_line("ready", start_limit_s())
            children.append(hub)
        except BenchError:
            if hub.returncode != 0:  # 0: the channel has a hub already
                raise
    _nobody_else(bus, plan)
    ours = {bus_identifier(codec) for codec in codecs}
    link = stack.enter_context(Transport.open(bus, name="restbus", receive=ours))
    if options.start_node:
        node = Child(
            device.name, device.name,
            ["--scenario", str(device.file), "--die-with-parent", "--priority", str(options.priority),
             *bus.to_arguments()],
            logs=scratch,
        )  # fmt: skip
        stack.callback(node.end)
        children.append(node)
    wait_s = (
        options.wait_s if options.wait_s is not None else (start_limit_s() if options.start_node else 10.0)
    )
    name = next(codec.name for codec in codecs if bus_identifier(codec) == plan.anchor)
    tell(f"waiting for {name} of {device.name} on {bus}")
    try:
        # Below a node of ours: what it is to be given must not keep it from answering.
        with keeping_time(max(options.priority - 1, min(options.priority, 1))):
            live = play_live(
                link, plan.restbus, anchors=[plan.anchor], until_ns=plan.until_ns, wait_s=wait_s,
                should_stop=should_stop, show=show,
            )  # fmt: skip
    except Silent:
        raise BenchError(
            f"{bus}: no {name} (0x{plan.anchor & 0x1FFFFFFF:X}) of {device.name} in {wait_s:g} s;"
            " is the device on, on this bus, at this bit rate? --start-node starts our own"
        ) from None
    return live, link.dropped


def _nobody_else(bus: BusOptions, plan: _Plan) -> None:
    """Raises BenchError if a node that the restbus is to play speaks for itself."""
    theirs = {due.can_id for due in plan.restbus}
    with Transport.open(bus, name="restbus", receive=theirs) as listener:
        heard: Frame | None = listener.receive(LISTEN_BEFORE_START_S)
    if heard is not None:
        raise BenchError(
            f"{bus}: somebody already sends 0x{heard.can_id & 0x1FFFFFFF:X}, which the replay would send too;"
            " leave only the device on the bus"
        )
