"""What a node runs: the `Unit` protocol, its probes, and the bus as a node sees it (`FrameLink`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.node.inbox import Inbox
from hil.node.outbox import Outbox
from hil.node.phase import PHASE_NS, phase_off_the_tick

__all__ = ["FrameLink", "Probe", "Unit", "UnitBuilder", "default_phase_ns"]


class Probe(NamedTuple):
    """One inner value of a unit that is written to the timing ring every cycle (no bus load)."""

    name: str
    unit: str


class Unit(Protocol):
    """Pure control: inputs in, outputs out. No I/O and no clock of its own.

    `nodes` are the DBC nodes the unit plays; the first one acknowledges SYNC. `after` names the SyncDone
    messages that the unit waits for in lockstep. A unit may also have `every_cycle: tuple[str, ...]`:
    cyclic messages that go out in each of its cycles, whatever cycle time the DBC gives. And it may have
    `between_cycles()`, called in lockstep after each cycle, outside what is timed, and `start_helper()` with
    `close()` around it in real time: work that a cycle has no time for. And `twin()`: a unit of the same
    kind with state of its own and no side effects, for the rehearsals of `hil.node.rehearsal`.
    """

    @property
    def name(self) -> str:
        """What the unit is called in reports, for example "controller"."""

    @property
    def nodes(self) -> tuple[str, ...]:
        """DBC nodes this unit plays."""

    @property
    def receives(self) -> tuple[str, ...]:
        """Names of the messages it reads."""

    @property
    def period_ns(self) -> int:
        """Length of its cycle in ns."""

    @property
    def probes(self) -> tuple[Probe, ...]:
        """What `probe` returns, in the same order."""

    @property
    def after(self) -> tuple[str, ...]:
        """SyncDone messages awaited in lockstep before a step."""

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """One cycle at the nominal time `now_ns` (the grid in real time, the tick in lockstep)."""

    def probe(self) -> tuple[float, ...]:
        """Values of the probes after the step."""

    def stop(self, outbox: Outbox) -> None:
        """Put safe outputs; they are sent once when the node ends."""

    def warm_up(self) -> None:
        """Run every code path before the first deadline, without side effect."""


UnitBuilder = Callable[[Path, Contract], Unit]


class FrameLink(Protocol):
    """The bus as a node needs it: `hil.canbus.transport.Transport`, or anything that does the same."""

    @property
    def sent(self) -> int:
        """Frames sent."""

    @property
    def received(self) -> int:
        """Frames received."""

    @property
    def dropped(self) -> int:
        """Frames known to be lost."""

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """Send one frame; raises BusError when it cannot."""

    def send_all(self, frames: Sequence[tuple[int, bytes | bytearray]]) -> None:
        """Send frames in this order; raises BusError when it cannot."""

    def drain(self) -> list[Frame]:
        """All frames that wait; never blocks."""

    def receive(self, timeout_s: float | None) -> Frame | None:
        """The next frame, or None when none came within `timeout_s`."""


def default_phase_ns(unit: Unit) -> int:
    """Phase of the unit's deadlines on the grid, in ns.

    A unit that follows another one in lockstep (`after`) follows it by half a period in real time.
    """
    return phase_off_the_tick(unit.period_ns, PHASE_NS + (unit.period_ns // 2 if unit.after else 0))


def every_cycle(unit: Unit) -> tuple[str, ...]:
    """Messages that the unit wants sent in each of its cycles (optional attribute of a unit)."""
    names: Mapping[str, object] | tuple[str, ...] = getattr(unit, "every_cycle", ())
    return tuple(names)
