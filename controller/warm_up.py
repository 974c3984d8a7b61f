"""The warm-up of the ATO unit: a twin gets under way, so that no path runs first in a deadline."""

from __future__ import annotations

from collections.abc import Mapping

from hil.canbus.contract import Contract, MessageCodec
from hil.canbus.protection import Protector
from hil.node.inbox import Inbox, bus_identifier
from hil.node.outbox import Outbox
from hil.node.unit import Unit, every_cycle

__all__ = ["READY_TO_LEAVE", "get_under_way"]

CYCLES = 200
"""The interpreter specialises a function within some ten calls; the unit is under way after two cycles."""

READY_TO_LEAVE: dict[str, dict[str, float]] = {
    "TCU_Status": {"State": 1},
    "BCU_Status": {"State": 1, "HoldingApplied": 1},
    "ODO_Motion": {"Valid": 1, "Standstill": 1},
    "ATP_Permission": {"DoorsClosed": 1, "DepartureAuthorised": 1, "PermittedSpeed": 10.0},
}
"""What the other units say of a train that stands at its origin and may depart."""


def get_under_way(twin: Unit, contract: Contract, position_m: float) -> None:
    """Run some hundred whole cycles of `twin`, a unit nobody else uses, with the train at `position_m`."""
    inbox = Inbox(contract, twin.receives)
    outbox = Outbox(contract, twin.nodes, twin.period_ns, every_cycle=every_cycle(twin))
    inputs = READY_TO_LEAVE | {"ODO_Motion": READY_TO_LEAVE["ODO_Motion"] | {"Position": position_m}}
    senders = [_Sender(contract.message(name), values) for name, values in inputs.items()]
    for cycle in range(CYCLES):
        now_ns = cycle * twin.period_ns
        inbox.begin(now_ns)
        for sender in senders:
            inbox.accept(now_ns, *sender.frame())
        twin.step(now_ns, inbox, outbox)
        twin.probe()
        outbox.collect(cycle)


class _Sender:
    """Another node: the same values again and again, well protected."""

    def __init__(self, codec: MessageCodec, values: Mapping[str, float]) -> None:
        self._codec = codec
        self._values = values
        self._protector = Protector(codec.protection) if codec.protection else None

    def frame(self) -> tuple[int, bytes]:
        """Identifier and data of the next one."""
        data = self._codec.encode(self._values)
        if self._protector is not None:
            self._protector.protect(data)
        return bus_identifier(self._codec), bytes(data)
