"""When a node's cycle starts: the interface of its clocks, and absolute deadlines in real time.

Every clock has `wait()` for the start of the cycle, `frames()` for what arrived until then, and
`finished()` when the cycle's outputs are sent. The lockstep clock is in `lockstep.py`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol

from hil.canbus.frame import Frame
from hil.node.inbox import NO_TIMING
from hil.node.nanosleep import sleeper
from hil.node.spin import SpinChoice, choose_spin

if TYPE_CHECKING:
    from hil.node.rehearsal import Rehearsal
    from hil.node.unit import FrameLink

__all__ = [
    "Clock",
    "CycleStart",
    "RealTimeClock",
    "first_deadline",
    "next_deadline",
    "realtime_offset_ns",
]

# Frames are stamped by the interface. Stamps that claim an arrival long before the previous drain do not
# come from this host's CLOCK_REALTIME (some adapters count from their own power-up).
STAMP_TOLERANCE_NS = 1_000_000_000
# A jump of CLOCK_REALTIME against CLOCK_MONOTONIC by more than this is a step (NTP slews move both).
STEP_NS = 1_000_000


class CycleStart(NamedTuple):
    """Start of one cycle, ns.

    `scheduled_ns` is the nominal time (monotonic grid, or tick * tick period in lockstep), `woke_ns` the
    monotonic time of the wake-up, `skipped` the whole cycles left out just before this one, `now_ns` the
    time in the domain of the frames' stamps, from which ages are counted. `idle`: a lockstep tick that is not
    the unit's; it is acknowledged without a step.
    """

    scheduled_ns: int
    woke_ns: int
    skipped: int
    now_ns: int
    idle: bool = False


class Clock(Protocol):
    """What the cycle needs from a clock."""

    @property
    def kind(self) -> str:
        """Either "realtime" or "lockstep"."""

    @property
    def realtime_offset_ns(self) -> int:
        """CLOCK_REALTIME minus CLOCK_MONOTONIC, ns."""

    def wait(self, should_stop: Callable[[], bool] = ...) -> CycleStart | None:
        """Block until the next cycle starts; None when `should_stop` said so."""

    def frames(self) -> list[Frame]:
        """Frames for this cycle, oldest first, their stamps in the domain of `CycleStart.now_ns`."""

    def closing(self) -> list[tuple[int, bytes | bytearray]]:
        """What the clock itself has to say after the cycle's outputs, to go out with them."""

    def finished(self, ended_ns: int) -> int:
        """The cycle's work ended at monotonic `ended_ns`; how many releases passed unmet until then."""


def never() -> bool:
    """Do not stop."""
    return False


def first_deadline(now_ns: int, period_ns: int, phase_ns: int) -> int:
    """First point of the grid k*period + phase that lies after `now_ns`."""
    return ((now_ns - phase_ns) // period_ns + 1) * period_ns + phase_ns


def next_deadline(now_ns: int, scheduled_ns: int, period_ns: int) -> tuple[int, int]:
    """Deadline after the one at `scheduled_ns`, and how many whole cycles are skipped to reach it.

    An overrun skips whole cycles and keeps the phase; missed cycles are never made up for in a burst
    (the policy of ros2_control's controller manager).
    """
    release = scheduled_ns + period_ns
    late = now_ns - release
    if late <= 0:
        return release, 0
    skipped = -(-late // period_ns)
    return release + skipped * period_ns, skipped


def realtime_offset_ns(
    monotonic: Callable[[], int] = time.monotonic_ns, realtime: Callable[[], int] = time.time_ns
) -> int:
    """CLOCK_REALTIME minus CLOCK_MONOTONIC in ns: the tightest of a few readings."""
    tightest = None
    offset = 0
    for _ in range(5):
        before = monotonic()
        wall = realtime()
        after = monotonic()
        if tightest is None or after - before < tightest:
            tightest = after - before
            offset = wall - (before + after) // 2
    return offset


class RealTimeClock:
    """Absolute deadlines on the grid k*period + phase of CLOCK_MONOTONIC.

    Sleeps until shortly before the deadline and polls the clock for the rest: a wake-up latency of a
    microsecond instead of tens, for spin/period of one core. `spin` says how long before; without it it is
    `spin_ns`, fixed, and 0 is a plain absolute sleep. With a `rehearsal` the sleep ends sooner by its
    lead: what waits on the transport is taken then, and the rehearsal run, if there is time for it.
    `sleep_until` sleeps until a moment of `monotonic` and returns its time then (None: the system's).
    """

    kind = "realtime"

    def __init__(
        self,
        period_ns: int,
        phase_ns: int,
        spin_ns: int = 200_000,
        monotonic: Callable[[], int] = time.monotonic_ns,
        sleep_until: Callable[[int], int] | None = None,
        *,
        transport: FrameLink | None = None,
        realtime: Callable[[], int] = time.time_ns,
        spin: SpinChoice | None = None,
        rehearsal: Rehearsal | None = None,
    ) -> None:
        if period_ns <= 0:
            raise ValueError(f"period_ns: {period_ns} must be greater than 0")
        if not 0 <= spin_ns <= period_ns:
            raise ValueError(f"spin_ns: {spin_ns} must be between 0 and the period, {period_ns}")
        self.period_ns = period_ns
        self.phase_ns = phase_ns
        self.spin = spin or choose_spin(spin_ns, period_ns)
        self.margin = self.spin.margin()
        self.rehearsal = rehearsal if self.margin.largest_ns else None
        self.realtime_offset_ns = realtime_offset_ns(monotonic, realtime)
        self.realtime_steps = 0
        self._monotonic = monotonic
        self._realtime = realtime
        self._sleep_until = sleep_until or sleeper()
        self._transport = transport
        self._deadline = 0
        self._skipped = 0
        self._drained_ns = monotonic()
        self._early: list[Frame] = []

    def wait(self, should_stop: Callable[[], bool] = never) -> CycleStart | None:
        """Block until the deadline; None when `should_stop` says so afterwards."""
        monotonic = self._monotonic
        now = monotonic()
        if not self._deadline:
            self._deadline = self._first_deadline(now)
        deadline = self._deadline
        margin, rehearsal = self.margin, self.rehearsal
        sleep_until = deadline - margin.now_ns
        if rehearsal is not None:
            sleep_until -= rehearsal.lead.now_ns
        slept = now < sleep_until
        while now < sleep_until:
            now = self._sleep_until(sleep_until)
        if rehearsal is not None:
            if deadline - now >= rehearsal.lead.now_ns:
                self._rehearse(rehearsal)
                now = monotonic()
            else:
                rehearsal.skipped += 1
        if slept:  # late sleep and long rehearsal together: the poll has to make up for both
            margin.observe(now - (deadline - margin.now_ns))
        while now < deadline:
            now = monotonic()
        if should_stop():
            return None
        return CycleStart(deadline, now, self._skipped, now)

    def frames(self) -> list[Frame]:
        """Everything that waits on the transport, stamps converted to CLOCK_MONOTONIC."""
        if self._transport is None:
            return []
        arrived = self._transport.drain()
        if self._early:
            arrived = self._early + arrived
            self._early = []
        now = self._monotonic()
        offset = self._realtime() - now
        if abs(offset - self.realtime_offset_ns) > STEP_NS:
            offset = realtime_offset_ns(self._monotonic, self._realtime)
            if abs(offset - self.realtime_offset_ns) > STEP_NS:
                self.realtime_offset_ns = offset
                self.realtime_steps += 1
        offset = self.realtime_offset_ns
        oldest = self._drained_ns - STAMP_TOLERANCE_NS
        self._drained_ns = now
        frames = []
        for stamp, can_id, data in arrived:
            at = stamp - offset
            frames.append(Frame(at if oldest <= at <= now else now, can_id, data))
        return frames

    def _first_deadline(self, now_ns: int) -> int:
        """The first deadline; with a rehearsal, the first one that leaves time for it."""
        rehearsal = self.rehearsal
        if rehearsal is None:
            return first_deadline(now_ns, self.period_ns, self.phase_ns)
        needed_ns = rehearsal.lead.largest_ns + self.margin.largest_ns
        deadline = first_deadline(now_ns + needed_ns, self.period_ns, self.phase_ns)
        rehearsal.remember(deadline - self.period_ns, now_ns, [], NO_TIMING)
        return deadline

    def _rehearse(self, rehearsal: Rehearsal) -> None:
        """Take what has arrived so far, and warm the caches."""
        if self._transport is not None:
            self._early += self._transport.drain()
        rehearsal()
        if rehearsal.failure:
            self.rehearsal = None

    def closing(self) -> list[tuple[int, bytes | bytearray]]:
        """Nothing: time passes by itself."""
        return []

    def finished(self, ended_ns: int) -> int:
        """Choose the next deadline; the number of deadlines missed, which are the cycles skipped."""
        self._deadline, self._skipped = next_deadline(ended_ns, self._deadline, self.period_ns)
        return self._skipped
