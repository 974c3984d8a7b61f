"""The nodes on a wire: who hears whom, and what a frame or an error does to their error counters."""

from __future__ import annotations

from collections.abc import Hashable, ItemsView

from hil.canbus.local.confinement import Notice
from hil.canbus.local.medium_node import Node, Transmission
from hil.canbus.local.wire_frame import Reported


class Membership:
    """The nodes that joined. `listeners`: others beyond them that acknowledge every frame."""

    def __init__(self, listeners: int) -> None:
        self._listeners = listeners
        self._nodes: dict[Hashable, Node] = {}
        self._hearing = 0  # nodes that acknowledge
        self._calm = True  # all error counters are 0
        self._joined = 0

    def __getitem__(self, name: Hashable) -> Node:
        return self._nodes[name]

    def get(self, name: Hashable) -> Node | None:
        """A node; None: it has not joined, or is forgotten."""
        return self._nodes.get(name)

    def nodes(self) -> ItemsView[Hashable, Node]:
        """All, by name, in the order in which they joined."""
        return self._nodes.items()

    def join(self, name: Hashable) -> Node:
        """A node takes part from now on."""
        node = self._nodes.get(name)
        if node is None:
            self._joined += 1
            node = self._nodes[name] = Node(self._joined)
            self._hearing += 1
        return node

    def leave(self, node: Node) -> None:
        """A node acknowledges no more."""
        self._hearing -= node.listens
        node.leaving = True

    def switched_off(self, node: Node) -> None:
        """A node went bus-off: it hears nothing any more."""
        self._hearing -= not node.leaving

    def recovered(self, name: Hashable, time_ns: int) -> list[Reported]:
        """A node that was bus-off takes part again."""
        node = self._nodes[name]
        node.restart_at_ns = None
        self._hearing += not node.leaving
        return _reports(time_ns, name, node.confinement.recovered())

    def hears(self, sender: Hashable) -> bool:
        """Whether anybody acknowledges the frames of `sender`."""
        node = self._nodes.get(sender)
        return self._hearing + self._listeners > (0 if node is None or node.leaving else 1)

    def transmitted(self, sending: Transmission) -> list[Reported]:
        """A frame was sent and acknowledged: error counters go down."""
        if self._calm:
            return []
        node, end_ns = sending.node, sending.end_ns
        reports = _reports(end_ns, sending.sender, node.confinement.transmitted())
        for name, other in self._others(node):
            reports += _reports(end_ns, name, other.confinement.received())
        self._calm = all(
            not other.confinement.tec and not other.confinement.rec for other in self._nodes.values()
        )
        return reports

    def failed(self, sending: Transmission) -> list[Reported]:
        """An error frame was sent: error counters go up."""
        node, end_ns = sending.node, sending.end_ns
        self._calm = False
        unheard = sending.failure == "ack"
        reports = _reports(end_ns, sending.sender, node.confinement.transmit_failed(acknowledge=unheard))
        for name, other in self._others(node):
            reports += _reports(end_ns, name, other.confinement.receive_failed())
        return reports

    def take_idle(self, sending: Node | None) -> list[Hashable]:
        """Forget the nodes that left and have nothing to send, or nobody to send it to; which they were."""
        alone = not self._listeners and all(node.leaving for node in self._nodes.values())
        idle = [
            name
            for name, node in self._nodes.items()
            if node.leaving and node is not sending and (alone or not node.waiting)
        ]
        for name in idle:
            del self._nodes[name]
        return idle

    def _others(self, sender: Node) -> list[tuple[Hashable, Node]]:
        return [(name, node) for name, node in self._nodes.items() if node is not sender and node.listens]


def _reports(time_ns: int, name: Hashable, notices: list[Notice]) -> list[Reported]:
    return [Reported(time_ns, name, notice) for notice in notices]
