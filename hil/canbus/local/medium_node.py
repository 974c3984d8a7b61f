"""A node as the model of the wire sees it: frames that wait, error counters, what became of its frames."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from hil.canbus.local.bits import FrameBits
from hil.canbus.local.confinement import Confinement, State
from hil.canbus.local.wire_frame import WireFrame

Failure = Literal["", "bit", "ack"]
"""Why a transmission did not end well: a bit error, or nobody acknowledged."""


class Waiting(NamedTuple):
    """A frame in the queue of a node."""

    key: tuple[int, int]
    """Order within a queue: priority (0 in a first-in first-out queue), then age."""
    arbitration: int
    queued_ns: int
    frame: WireFrame
    bits: FrameBits


@dataclass(slots=True)
class Node:
    """One node; `waiting` is a heap."""

    number: int
    confinement: Confinement = field(default_factory=Confinement)
    waiting: list[Waiting] = field(default_factory=list)
    suspended_until_ns: int = 0
    restart_at_ns: int | None = None
    """Bus-off: from here on recessive bits are counted."""
    sequences_left: int = 0
    leaving: bool = False
    sent: int = 0
    retransmissions: int = 0
    dropped: int = 0

    @property
    def listens(self) -> bool:
        """Whether it takes part in the traffic of others."""
        return not self.leaving and self.confinement.state is not State.BUS_OFF

    def statistics(self, name: Hashable, pending: int) -> dict[str, Any]:
        """Counters, JSON types; `pending` frames wait, the one on the wire included."""
        return {
            "node": str(name),
            "state": str(self.confinement.state),
            "tec": self.confinement.tec,
            "rec": self.confinement.rec,
            "pending": pending,
            "sent": self.sent,
            "retransmissions": self.retransmissions,
            "dropped": self.dropped,
        }


class Transmission(NamedTuple):
    """A frame on the wire; the bus is free again at `free_ns`, after the interframe space."""

    sender: Hashable
    node: Node
    entry: Waiting
    start_ns: int
    end_ns: int
    free_ns: int
    failure: Failure
