"""The way back from bus-off: a restart time, then 128 sequences of 11 recessive bits (ISO 11898-1)."""

from __future__ import annotations

from collections.abc import Hashable

from hil.canbus.local.bits import duration_ns
from hil.canbus.local.confinement import RECOVERY_SEQUENCE_BITS, RECOVERY_SEQUENCES
from hil.canbus.local.medium_node import Node

RESTART_NS = 100_000_000


class Recovery:
    """The nodes that are bus-off. `restart_ns`: how long until they count; None: until they are told to."""

    def __init__(self, bitrate: int, restart_ns: int | None) -> None:
        self._bitrate = bitrate
        self._restart_ns = restart_ns
        self._off: dict[Hashable, Node] = {}

    def __bool__(self) -> bool:
        return bool(self._off)

    def add(self, name: Hashable, node: Node, now_ns: int) -> None:
        """A node went bus-off."""
        self._off[name] = node
        node.sequences_left = RECOVERY_SEQUENCES
        node.restart_at_ns = None if self._restart_ns is None else now_ns + self._restart_ns

    def remove(self, name: Hashable) -> None:
        """A node takes part again, or is gone."""
        self._off.pop(name, None)

    def next(self, free_ns: int) -> tuple[int, Hashable] | None:
        """When a node takes part again if the bus is free from `free_ns` on and stays so, and which."""
        times = [
            (
                max(free_ns, node.restart_at_ns)
                + self._time(max(0, node.sequences_left) * RECOVERY_SEQUENCE_BITS),
                node.number,
                name,
            )
            for name, node in self._off.items()
            if node.restart_at_ns is not None
        ]
        if not times:
            return None
        time_ns, _, name = min(times)
        return time_ns, name

    def count_idle(self, free_ns: int, start_ns: int) -> None:
        """The bus was idle from `free_ns` to `start_ns`."""
        if not self._off:
            return
        sequence_ns = self._time(RECOVERY_SEQUENCE_BITS)
        for node in self._off.values():
            if node.restart_at_ns is not None:
                idle_ns = start_ns - max(free_ns, node.restart_at_ns)
                node.sequences_left -= max(0, idle_ns) // sequence_ns

    def count_frame(self, start_ns: int) -> None:
        """A frame, or an error frame, that started then has ended: with 11 recessive bits."""
        for node in self._off.values():
            if node.restart_at_ns is not None and node.restart_at_ns <= start_ns:
                node.sequences_left -= 1

    def _time(self, bits: int) -> int:
        return duration_ns(bits, 0, self._bitrate)
