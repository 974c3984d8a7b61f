"""Who sends next: of the first frames of all nodes that are ready, the lowest identifier."""

from __future__ import annotations

import heapq
from collections.abc import Hashable, ItemsView

from hil.canbus.local.medium_node import Node, Waiting


class Arbitration:
    """The nodes that have frames to send."""

    def __init__(self) -> None:
        self._offering: dict[Hashable, Node] = {}
        self.collisions = 0
        """How often a node that offered the lowest identifier met another with the same one."""

    def offer(self, name: Hashable, node: Node, entry: Waiting) -> None:
        """A frame waits in the queue of a node from now on, or again."""
        self._offering[name] = node
        heapq.heappush(node.waiting, entry)

    def withdraw(self, name: Hashable) -> None:
        """A node has nothing to send any more."""
        self._offering.pop(name, None)

    def nodes(self) -> ItemsView[Hashable, Node]:
        """Those with frames that wait, by name."""
        return self._offering.items()

    def next_ready_ns(self) -> int | None:
        """When the first of them may send, if the bus is free; None: there is none."""
        ready = [max(node.waiting[0].queued_ns, node.suspended_until_ns) for node in self._offering.values()]
        return min(ready) if ready else None

    def take_winner(self, start_ns: int) -> tuple[Hashable, Node, Waiting]:
        """The node that wins at `start_ns`, and its frame, which leaves the queue; one has to be ready."""
        best: tuple[int, int] | None = None
        winner: Hashable = None
        same = 0  # others that offer the identifier of the best one
        for name, node in self._offering.items():
            if node.suspended_until_ns > start_ns:
                continue
            first = node.waiting[0]
            if first.queued_ns > start_ns:
                continue
            rank = (first.arbitration, first.key[1])
            if best is None or rank[0] < best[0]:
                same = 0
            elif rank[0] == best[0]:
                same += 1
            if best is None or rank < best:
                best, winner = rank, name
        self.collisions += same
        node = self._offering[winner]
        entry = heapq.heappop(node.waiting)  # a more urgent one may be queued meanwhile
        if not node.waiting:
            del self._offering[winner]
        return winner, node, entry
