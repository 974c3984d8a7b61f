"""A bus inside one thread: frames handed over in order, without copies, sockets or locks.

What python-can's `virtual` is between threads, this is between units that take turns in one thread, as
in lockstep within one process. It copies no message per receiver, which is most of the cost there.

The bus may lose frames on purpose, each with the same probability and for all receivers alike; which ones
follows from a seed alone.
"""

from __future__ import annotations

import random
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from hil.canbus.frame import Frame


@dataclass(frozen=True)
class Loss:
    """Frames lost on purpose: each with `probability`, but none of the identifiers in `spared`."""

    probability: float
    seed: int
    spared: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        if not 0.0 <= self.probability <= 1.0:
            raise ValueError(f"probability of a lost frame {self.probability:g}: must be 0 to 1")


class MemoryChannel:
    """The bus itself; `link()` joins it. Not for use from several threads."""

    def __init__(self, loss: Loss | None = None) -> None:
        self._links: list[MemoryLink] = []
        self._losses = _Losses(loss) if loss is not None and loss.probability > 0.0 else None

    @property
    def lost(self) -> int:
        """Frames lost on purpose so far."""
        return 0 if self._losses is None else self._losses.count

    def link(self, receive: Iterable[int] | None = None) -> MemoryLink:
        """Join the bus; `receive` are the identifiers to keep, None keeps all."""
        link = MemoryLink(self._links, None if receive is None else frozenset(receive), self._losses)
        self._links.append(link)
        for other in self._links:
            other._routes.clear()
        return link


class MemoryLink:
    """One unit's place on a MemoryChannel; has what a `Transport` has for sending and receiving."""

    def __init__(
        self, links: list[MemoryLink], receive: frozenset[int] | None, losses: _Losses | None = None
    ) -> None:
        self.sent = 0
        self.received = 0
        self.dropped = 0  # nothing is lost here but on purpose, which no interface notices
        self._losses = losses
        self._links = links
        self._receive = receive
        self._waiting: deque[Frame] = deque()
        self._routes: dict[int, list[deque[Frame]]] = {}

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """Hand a frame to every other link that keeps its identifier."""
        self.sent += 1
        if self._losses is not None and self._losses.hits(can_id):
            return
        frame = Frame(time.time_ns(), can_id, bytes(data))
        route = self._routes.get(can_id)
        if route is None:
            route = self._routes[can_id] = self._route(can_id)
        for waiting in route:
            waiting.append(frame)

    def _route(self, can_id: int) -> list[deque[Frame]]:
        """Who keeps this identifier, of the others on the bus."""
        return [
            link._waiting
            for link in self._links
            if link is not self and (link._receive is None or can_id in link._receive)
        ]

    def send_all(self, frames: Iterable[tuple[int, bytes | bytearray]]) -> None:
        """Hand over frames in this order."""
        for can_id, data in frames:
            self.send(can_id, data)

    def drain(self) -> list[Frame]:
        """All frames that wait."""
        frames = list(self._waiting)
        self._waiting.clear()
        self.received += len(frames)
        return frames

    def receive(self, timeout_s: float | None = None) -> Frame | None:
        """The next frame, or None: within one thread nothing comes by waiting."""
        if not self._waiting:
            return None
        self.received += 1
        return self._waiting.popleft()


class _Losses:
    """Decides frame by frame; every frame that is not spared draws one number, so a seed is a sequence."""

    def __init__(self, loss: Loss) -> None:
        self.count = 0
        self._probability = loss.probability
        self._spared = loss.spared
        self._draw = random.Random(loss.seed).random

    def hits(self, can_id: int) -> bool:
        if can_id in self._spared or self._draw() >= self._probability:
            return False
        self.count += 1
        return True
