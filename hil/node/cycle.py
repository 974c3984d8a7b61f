"""One node: a unit, its clock, its place on the bus. One cycle: wait, read, step, send, record."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from hil.canbus.contract import Contract
from hil.canbus.protection import Protector
from hil.node.clock import Clock, RealTimeClock, never
from hil.node.inbox import CycleTiming, Inbox, bus_identifier
from hil.node.outbox import Outbox
from hil.node.rehearsal import Rehearsal
from hil.node.spin import spin_report
from hil.node.timing import TimingRing
from hil.node.unit import FrameLink, Unit, every_cycle

__all__ = ["CycleStatistics", "DeadlinesMissed", "Node", "OverloadPolicy"]

TIMING_WINDOW_NS = 100_000_000


class DeadlinesMissed(RuntimeError):
    """More deadlines were missed than the overload policy allows."""

    exit_code = 3


@dataclass(frozen=True, slots=True)
class OverloadPolicy:
    """What missed deadlines mean, in the manner of Simulink Real-Time's overload options.

    Misses in the first cycles, as many as fit in `startup_ns` (skipped ones do not count), are counted apart
    and never halt. After that the node halts with
    DeadlinesMissed above `maximum` misses in all or `maximum_consecutive` in a row; None: it never halts.
    """

    startup_ns: int = 200_000_000
    maximum: int | None = None
    maximum_consecutive: int | None = None

    def check(self, counts: CycleStatistics) -> None:
        """Raise DeadlinesMissed when the counts are above a limit."""
        for missed, limit, how in (
            (counts.missed, self.maximum, "in all"),
            (counts.consecutive, self.maximum_consecutive, "in a row"),
        ):
            if limit is not None and missed > limit:
                raise DeadlinesMissed(
                    f"{missed} deadlines missed {how} after {counts.cycles} cycles, limit {limit}: "
                    "give the node a longer period, or SCHED_FIFO and a CPU of its own"
                )


@dataclass(slots=True)
class CycleStatistics:
    """Counters of a node. `missed`: deadlines missed, each release that came before the work of the cycle
    before it had ended. The cycle of such a release is skipped, so a stall of 50 periods misses 50, in a row.
    """

    cycles: int = 0
    missed: int = 0
    missed_startup: int = 0
    skipped: int = 0
    consecutive: int = 0
    max_consecutive_misses: int = 0

    def count(self, missed: int, startup: bool) -> None:
        """Count one finished cycle, and the deadlines that were missed until its end."""
        self.cycles += 1
        if not missed:
            self.consecutive = 0
        elif startup:
            self.missed_startup += missed
        else:
            self.missed += missed
            self.consecutive += missed
            self.max_consecutive_misses = max(self.max_consecutive_misses, self.consecutive)


class WindowMaximum:
    """Greatest of the last `length` values; looks at all of them only when the greatest leaves."""

    __slots__ = ("_next", "_values", "maximum")

    def __init__(self, length: int) -> None:
        self.maximum = 0
        self._values = [0] * length
        self._next = 0

    def add(self, value: int) -> None:
        """Take a value in, and the oldest out."""
        values, at = self._values, self._next
        leaves, values[at] = values[at], value
        self._next = at + 1 if at + 1 < len(values) else 0
        if value >= self.maximum:
            self.maximum = value
        elif leaves == self.maximum:
            self.maximum = max(values)


class Node:
    """Runs one unit on one transport with one clock; the ring may be None (nothing is recorded).

    Exceptions of the transport (BusError), the clock (LockstepError), the outbox (EncodeError) and the unit
    pass through `cycle` and `run`; `stop` then still sends what the unit calls safe, if the bus lives.
    """

    def __init__(
        self,
        unit: Unit,
        transport: FrameLink,
        clock: Clock,
        ring: TimingRing | None,
        contract: Contract,
        *,
        overload: OverloadPolicy | None = None,
        monotonic: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.unit = unit
        self.transport = transport
        self.clock = clock
        self.ring = ring
        self.contract = contract
        self.overload = overload or OverloadPolicy()
        self.inbox = Inbox(contract, unit.receives)
        self.outbox = Outbox(contract, unit.nodes, unit.period_ns, every_cycle=every_cycle(unit))
        self.statistics = CycleStatistics()
        self._monotonic = monotonic
        self._real_time = clock.kind == "realtime"
        self._between_cycles = getattr(unit, "between_cycles", None) if not self._real_time else None
        self._startup_cycles = -(-self.overload.startup_ns // unit.period_ns)
        window = max(1, TIMING_WINDOW_NS // unit.period_ns)
        self._latency = WindowMaximum(window)
        self._execution = WindowMaximum(window)
        self._rehearsal: Rehearsal | None = getattr(clock, "rehearsal", None)

    def warm_up(self) -> None:
        """Run the unit's and the codecs' code paths and touch the ring, without side effect."""
        warm_up(self.unit, self.contract)
        if self.ring is not None:
            self.ring.touch()

    def cycle(self, should_stop: Callable[[], bool] = never) -> bool:
        """Run one cycle; False when `should_stop` ended the wait for it."""
        start = self.clock.wait(should_stop)
        if start is None:
            return False
        if start.idle:
            self.clock.finished(start.woke_ns)
            return True
        monotonic = self._monotonic
        unit, inbox, outbox, statistics = self.unit, self.inbox, self.outbox, self.statistics
        inbox.begin(start.now_ns)
        frames = self.clock.frames()
        accept = inbox.accept
        for stamp_ns, can_id, data in frames:
            accept(stamp_ns, can_id, data)
        read_ns = monotonic()
        unit.step(start.scheduled_ns, inbox, outbox)
        stepped_ns = monotonic()
        out = outbox.collect(statistics.cycles) + self.clock.closing()
        encoded_ns = monotonic()
        if out:
            self.transport.send_all(out)
        sent_ns = monotonic()
        if self.ring is not None:
            self.ring.append(
                statistics.cycles, start.scheduled_ns, start.woke_ns, read_ns, stepped_ns, encoded_ns,
                sent_ns, start.skipped, *unit.probe(),
            )  # fmt: skip
        if self._rehearsal is not None:
            self._rehearsal.remember(start.scheduled_ns, start.now_ns, frames, inbox.timing)
        statistics.skipped += start.skipped
        missed = self.clock.finished(monotonic())
        if self._real_time:
            self._judge(missed, start.woke_ns - start.scheduled_ns, sent_ns - start.woke_ns)
        else:
            statistics.cycles += 1
            if self._between_cycles is not None:
                self._between_cycles()
        return True

    def run(self, should_stop: Callable[[], bool] = never) -> None:
        """Cycle until `should_stop`; the safe outputs are sent by `stop`."""
        while not should_stop():
            if not self.cycle(should_stop):
                break

    def stop(self) -> None:
        """Send the unit's safe outputs, once. Raises BusError when the bus does not take them."""
        self.unit.stop(self.outbox)
        self.transport.send_all(self.outbox.flush())

    def report(self) -> dict[str, Any]:
        """Counters of cycles, frames and received messages, ready for JSON."""
        counts = self.statistics
        return {
            "unit": self.unit.name,
            "nodes": list(self.unit.nodes),
            "clock": self.clock.kind,
            "period_ns": self.unit.period_ns,
            "cycles": counts.cycles,
            "missed": counts.missed,
            "missed_startup": counts.missed_startup,
            "max_consecutive_misses": counts.max_consecutive_misses,
            "skipped": counts.skipped,
            "spin": self._spin_report(),
            "rehearsal": None if self._rehearsal is None else self._rehearsal.report(),
            "realtime_steps": getattr(self.clock, "realtime_steps", 0),
            "frames": {
                "sent": self.transport.sent,
                "received": self.transport.received,
                "dropped": self.transport.dropped,
                "not_sent": getattr(self.transport, "not_sent", 0),
                "error_frames": getattr(self.transport, "error_frames", 0),
                "bus_state": str(getattr(self.transport, "bus_state", "unknown")),
            },
            "e2e": received_counters(self.inbox),
        }

    def _spin_report(self) -> dict[str, Any] | None:
        clock = self.clock
        if not isinstance(clock, RealTimeClock):
            return None
        return spin_report(clock.spin, clock.margin, clock.period_ns)

    def _judge(self, missed: int, latency_ns: int, execution_ns: int) -> None:
        """Count the cycle, tell the unit its timing, apply the overload policy."""
        counts = self.statistics
        self._latency.add(latency_ns)
        self._execution.add(execution_ns)
        counts.count(missed, counts.cycles < self._startup_cycles)
        self.inbox.timing = CycleTiming(
            self._latency.maximum, self._execution.maximum, counts.missed + counts.missed_startup
        )
        if missed:
            self.overload.check(counts)


def received_counters(inbox: Inbox) -> Mapping[str, Mapping[str, int]]:
    """E2E counters of every message received: ok, rejected, lost, timeouts."""
    return {
        name: {"ok": r.ok, "rejected": r.rejected, "lost": r.lost, "timeouts": r.timeouts}
        for name, r in inbox.messages.items()
    }


def warm_up(unit: Unit, contract: Contract) -> None:
    """Run the unit's code paths, then encode and decode each of its messages once, with counters apart."""
    unit.warm_up()
    unit.probe()
    names = [*unit.receives, *(codec.name for node in unit.nodes for codec in contract.sent_by(node))]
    outside = Inbox(contract, names)
    outside.begin(0)
    for received in outside.messages.values():
        codec = received.codec
        data = codec.encode(codec.start_values)
        if codec.protection is not None:
            Protector(codec.protection).protect(data)
        outside.accept(0, bus_identifier(codec), bytes(data))
