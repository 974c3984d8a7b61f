"""What a unit sends: current values of its cyclic messages, events, and its nodes' heartbeats.

Which message goes out in which cycle depends on the cycle count alone, so the same run gives the same
frames; messages with the same cycle time are spread over the cycles of that time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from operator import itemgetter

from hil.canbus.contract import Contract, ContractError, MessageCodec
from hil.canbus.protection import Protector
from hil.node.inbox import bus_identifier

__all__ = ["Outbox", "check_period"]

# NMT states of the heartbeat, CiA 301.
BOOT_UP, STOPPED, OPERATIONAL = 0, 4, 5

_by_can_id = itemgetter(0)


def check_period(
    contract: Contract, nodes: Iterable[str], period_ns: int, every_cycle: Iterable[str] = ()
) -> None:
    """Raise ContractError if a unit of this period leaves a cyclic message silent for too long."""
    always = frozenset(every_cycle)
    for codec in (codec for node in nodes for codec in contract.sent_by(node)):
        if codec.cycle_ns is None or codec.timeout_ns is None:
            continue
        interval_ns = period_ns * _every(codec, period_ns, always)
        if interval_ns >= codec.timeout_ns:
            raise ContractError(
                f"{period_ns * 1e-9:g} lets {codec.name} be sent every {interval_ns * 1e-6:g} ms, but its "
                f"receivers take {codec.timeout_ns * 1e-6:g} ms of silence for a fault; shorten it"
            )


def _every(codec: MessageCodec, period_ns: int, always: frozenset[str]) -> int:
    """In every how many-th cycle a message goes out."""
    if codec.cycle_ns is None or codec.name in always:
        return 1
    return max(1, round(codec.cycle_ns / period_ns))


class _Slot:
    """One message of a node: when it is due, what it carries, its E2E counter."""

    __slots__ = ("can_id", "codec", "every", "fresh", "offset", "protector", "values")

    def __init__(self, codec: MessageCodec, every: int) -> None:
        self.codec = codec
        self.can_id = bus_identifier(codec)
        self.every = every
        self.offset = 0
        self.values: Mapping[str, float] | None = None
        self.fresh = False
        self.protector = Protector(codec.protection) if codec.protection else None

    def frame(self, values: Mapping[str, float]) -> tuple[int, bytes]:
        data = self.codec.encode(values)
        if self.protector is not None:
            self.protector.protect(data)
        return self.can_id, bytes(data)


class Outbox:
    """Outputs of one unit that plays `nodes`, with a cycle of `period_ns`.

    A cyclic message is due every round(its DBC cycle / period) cycles, at least every cycle; those named in
    `every_cycle` always. It is not sent before its first `put`. Heartbeats need no `put`: BOOT_UP in the
    first cycle, OPERATIONAL from then on, STOPPED with the last outputs.
    """

    def __init__(
        self, contract: Contract, nodes: Iterable[str], period_ns: int, *, every_cycle: Iterable[str] = ()
    ) -> None:
        if period_ns <= 0:
            raise ValueError(f"period_ns: {period_ns} must be greater than 0")
        nodes = tuple(nodes)
        every_cycle = frozenset(every_cycle)
        contract.require(every_cycle)
        unknown = [node for node in nodes if node not in contract.nodes]
        if unknown:
            raise ContractError(
                f"{contract.path.name}: no node {', '.join(unknown)}; it has {', '.join(contract.nodes)}"
            )
        self._contract = contract
        self._nodes = nodes
        heartbeats = {f"{node}_Heartbeat" for node in nodes}
        self._slots: dict[str, _Slot] = {}
        self._cyclic: list[_Slot] = []
        self._heartbeats: list[_Slot] = []
        codecs = (codec for node in nodes for codec in contract.sent_by(node))
        for codec in sorted(codecs, key=lambda codec: codec.can_id):
            slot = _Slot(codec, _every(codec, period_ns, every_cycle))
            if codec.name in heartbeats:
                self._heartbeats.append(slot)
                slot.values = {"NmtState": BOOT_UP}
            else:
                self._slots[codec.name] = slot
            if codec.cycle_ns is not None:
                self._cyclic.append(slot)
        self._stagger()
        self._events: list[tuple[_Slot, Mapping[str, float]]] = []
        self._booted = False

    def put(self, name: str, values: Mapping[str, float]) -> None:
        """Set the values (SI) of a cyclic message; it is sent whenever its cycle is due.

        Raises ContractError when none of the unit's nodes sends the message cyclically.
        """
        slot = self._slot(name)
        if slot.codec.cycle_ns is None:
            raise ContractError(f"{self._contract.path.name}: {name} has no cycle time; send it with event()")
        slot.values = values
        slot.fresh = True

    def event(self, name: str, values: Mapping[str, float]) -> None:
        """Send a message once, in this cycle."""
        self._events.append((self._slot(name), values))

    def collect(self, cycle_index: int) -> list[tuple[int, bytes]]:
        """Frames of this cycle as (identifier, data), encoded and protected, identifiers ascending.

        Raises EncodeError when a value does not fit its signal.
        """
        frames: list[tuple[int, bytes]] = []
        for slot in self._cyclic:
            slot.fresh = False
            if slot.values is not None and cycle_index % slot.every == slot.offset:
                frames.append(slot.frame(slot.values))
        if not self._booted:
            self._booted = True
            sent = {can_id for can_id, _ in frames}
            for slot in self._heartbeats:
                if slot.can_id not in sent and slot.values is not None:
                    frames.append(slot.frame(slot.values))
                slot.values = {"NmtState": OPERATIONAL}
            frames.sort(key=_by_can_id)
        if self._events:
            frames.extend(slot.frame(values) for slot, values in self._events)
            self._events.clear()
            frames.sort(key=_by_can_id)  # stable: events of one message keep their order
        return frames

    def flush(self) -> list[tuple[int, bytes]]:
        """Last frames of a node that ends: heartbeats STOPPED, then all that was put since `collect`."""
        frames = [slot.frame({"NmtState": STOPPED}) for slot in self._heartbeats]
        last = [slot.frame(slot.values) for slot in self._cyclic if slot.fresh and slot.values is not None]
        last += [slot.frame(values) for slot, values in self._events]
        self._events.clear()
        for slot in self._cyclic:
            slot.fresh = False
        return frames + sorted(last, key=_by_can_id)

    def _slot(self, name: str) -> _Slot:
        slot = self._slots.get(name)
        if slot is None:
            if any(slot.codec.name == name for slot in self._heartbeats):
                raise ContractError(
                    f"{self._contract.path.name}: {name} is sent by the node, not by its unit"
                )
            sender = self._contract.message(name).sender
            nodes = ", ".join(self._nodes)
            raise ContractError(f"{self._contract.path.name}: {name} is sent by {sender}, not by {nodes}")
        return slot

    def _stagger(self) -> None:
        """Spread messages of equal cycle time evenly over the cycles of that time."""
        groups: dict[int, list[_Slot]] = {}
        for slot in self._cyclic:
            groups.setdefault(slot.every, []).append(slot)
        for every, slots in groups.items():
            for position, slot in enumerate(slots):
                slot.offset = position * every // len(slots)
