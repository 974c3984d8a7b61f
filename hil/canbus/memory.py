"""A bus inside one thread: frames handed over in order, without copies, sockets or locks.

What python-can's `virtual` is between threads, this is between units that take turns in one thread, as
in lockstep within one process. It copies no message per receiver, which is most of the cost there.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable

from hil.canbus.frame import Frame


class MemoryChannel:
    """The bus itself; `link()` joins it. Not for use from several threads."""

    def __init__(self) -> None:
        self._links: list[MemoryLink] = []

    def link(self, receive: Iterable[int] | None = None) -> MemoryLink:
        """Join the bus; `receive` are the identifiers to keep, None keeps all."""
        link = MemoryLink(self._links, None if receive is None else frozenset(receive))
        self._links.append(link)
        return link


class MemoryLink:
    """One unit's place on a MemoryChannel; has what a `Transport` has for sending and receiving."""

    def __init__(self, links: list[MemoryLink], receive: frozenset[int] | None) -> None:
        self.sent = 0
        self.received = 0
        self.dropped = 0  # nothing can be lost here
        self._links = links
        self._receive = receive
        self._waiting: deque[Frame] = deque()

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """Hand a frame to every other link that keeps its identifier."""
        self.sent += 1
        frame = Frame(time.time_ns(), can_id, bytes(data))
        for link in self._links:
            if link is not self and (link._receive is None or can_id in link._receive):
                link._waiting.append(frame)

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
