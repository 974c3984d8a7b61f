"""What a unit reads: the latest accepted values of each message, their age, and their E2E status."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from hil.canbus.contract import Contract, MessageCodec
from hil.canbus.frame import EXTENDED_ID_FLAG
from hil.canbus.protection import E2EStatus, Receiver

__all__ = ["CycleTiming", "Inbox", "Received", "bus_identifier"]


class CycleTiming(NamedTuple):
    """The node's own timing: worst values of the last 100 ms, ns, and misses since the start.

    All zero in lockstep, where nothing that was measured in real time may reach the bus.
    """

    wakeup_latency_ns: int = 0
    execution_ns: int = 0
    deadline_misses: int = 0


NO_TIMING = CycleTiming()

# names of this module: a look-up on the enumeration costs as much as the comparison it is for
_NO_NEW_DATA, _OK, _WRONG_CRC = E2EStatus.NO_NEW_DATA, E2EStatus.OK, E2EStatus.WRONG_CRC


def bus_identifier(codec: MessageCodec) -> int:
    """Identifier as frames carry it: 29-bit identifiers with EXTENDED_ID_FLAG."""
    return codec.can_id | EXTENDED_ID_FLAG if codec.extended else codec.can_id


class Received:
    """One message as its receiver sees it.

    `values` (SI; start values before the first) change whole or not at all. `status` is the E2E result of
    the latest frame since the last cycle, NO_NEW_DATA when none came. `events` holds the values of every
    accepted frame since the last cycle, for messages without a cycle time. Ages are in ns and count from
    the last accepted frame; before the first one from the start of the inbox.
    """

    __slots__ = (
        "_decode", "_receiver", "_silent", "_start_ns", "codec", "counter", "events", "fresh", "lost",
        "now_ns", "ok", "queues", "received", "rejected", "stamp_ns", "status", "timeout_ns", "timeouts",
        "values",
    )  # fmt: skip

    def __init__(self, codec: MessageCodec) -> None:
        self.codec = codec
        self._decode = codec.decode
        self.values: dict[str, float] = dict(codec.start_values)
        self.status = E2EStatus.NO_NEW_DATA
        self.received = False
        self.fresh = False
        self.ok = 0
        self.rejected = 0
        self.lost = 0
        self.timeouts = 0
        self.counter = 0
        self.events: list[dict[str, float]] = []
        self.queues = codec.cycle_ns is None
        self.timeout_ns = codec.timeout_ns
        self.stamp_ns = 0
        self.now_ns = 0
        self._start_ns: int | None = None
        self._silent = False
        self._receiver = Receiver(codec.protection, length=codec.length) if codec.protection else None

    def age_ns(self) -> int:
        """Time since the last accepted frame, ns."""
        return max(0, self.now_ns - self.stamp_ns)

    def timed_out(self) -> bool:
        """Whether the message has been silent for longer than its limit in the DBC."""
        return self.timeout_ns is not None and self.now_ns - self.stamp_ns > self.timeout_ns

    @property
    def valid(self) -> bool:
        """Received, not timed out, and not faulty by repeated E2E errors."""
        return self.received and not self.timed_out() and not self.faulty

    @property
    def faulty(self) -> bool:
        """Whether so many frames were rejected of late that the message is not to be trusted."""
        return self._receiver is not None and self._receiver.faulty

    def begin(self, now_ns: int) -> None:
        """Start a cycle at `now_ns`: nothing is fresh."""
        timeout_ns = self.timeout_ns
        if self._start_ns is None:
            self._start_ns = self.stamp_ns = now_ns
        elif timeout_ns is not None and self.now_ns - self.stamp_ns > timeout_ns:
            # Judged with the previous cycle's time, when all of that cycle's frames had been taken.
            if not self._silent:
                self.timeouts += 1
            self._silent = True
        else:
            self._silent = False
        self.now_ns = now_ns
        self.fresh = False
        self.status = _NO_NEW_DATA
        if self.events:
            self.events.clear()

    def accept(self, stamp_ns: int, data: bytes) -> bool:
        """Check one frame and take it whole, or count it as rejected and take nothing."""
        receiver = self._receiver
        if receiver is None:
            if len(data) != self.codec.length:
                self.status = _WRONG_CRC
                self.rejected += 1
                return False
            self.status = _OK
        else:
            status = self.status = receiver.check(data)
            self.lost = receiver.lost
            if not receiver.accepted(status):
                self.rejected += 1
                return False
            self.counter = receiver.counter
        self.values = self._decode(data)
        if self.queues:
            self.events.append(self.values)
        self.stamp_ns = stamp_ns
        self.received = True
        self.fresh = True
        self.ok += 1
        return True


class Inbox:
    """The messages a unit receives, by name. One cycle: `begin(now)`, `accept(...)` each frame, read."""

    def __init__(self, contract: Contract, names: Iterable[str]) -> None:
        names = tuple(names)
        contract.require(names)
        self.timing: CycleTiming = NO_TIMING
        self._received = {name: Received(contract.message(name)) for name in names}
        self._by_id = {bus_identifier(received.codec): received for received in self._received.values()}
        self._all = tuple(self._received.values())
        self._cyclic = tuple(r for r in self._all if r.codec.cycle_ns is not None)

    def __getitem__(self, name: str) -> Received:
        return self._received[name]

    @property
    def messages(self) -> Mapping[str, Received]:
        """All messages by name."""
        return self._received

    def begin(self, now_ns: int) -> None:
        """Start a cycle at `now_ns`, in the domain of the stamps given to `accept`."""
        for received in self._all:
            received.begin(now_ns)

    def accept(self, stamp_ns: int, can_id: int, data: bytes) -> None:
        """Take one frame; identifiers the unit does not receive are ignored."""
        received = self._by_id.get(can_id)
        if received is not None:
            received.accept(stamp_ns, data)

    def worst_age_ns(self) -> int:
        """Greatest age among the cyclic messages received so far, ns."""
        worst = 0
        for received in self._cyclic:
            age = received.now_ns - received.stamp_ns
            if age > worst and received.received:
                worst = age
        return worst
