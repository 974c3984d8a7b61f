"""The message set of a DBC: who sends what, how often, how long, until when. What the analysis starts from.

All messages of the file count, also those whose signals the bench cannot carry: they need the wire as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from cantools.database.can import Message, Node

import dbc
from hil.canbus.analysis.frame_time import FD_LENGTHS, MAX_CLASSIC_LENGTH, WireBits, best_bits, worst_bits
from hil.canbus.contract import NOBODY, message_attribute, read_database

NS_PER_MS = 1_000_000

MINIMUM_INTERVAL = "GenMsgDelayTime"
"""Vector's DBC attribute: the shortest time between two frames of a message [ms]."""

TRANSMIT_QUEUE = "TransmitQueue"
"""DBC attribute of a node: "priority" when its most urgent frame always competes, else "fifo"."""

LOCKSTEP = "sync"
"""`GenMsgSendType` of what is sent in lockstep only, where time is not the wire's."""


class MessageSetError(ValueError):
    """The message set cannot be analysed as asked: which message or option, and what would be right."""

    exit_code = 2


@dataclass(frozen=True)
class BusMessage:
    """One message as a load of the wire.

    `period_ns` is the cycle, or for an event the shortest time between two; `assumption` is empty, or says
    where a period that the file does not give comes from. `silence_ns` is the DBC's TimeoutMs.
    """

    name: str
    can_id: int
    extended: bool
    length: int
    sender: str
    period_ns: int
    deadline_ns: int
    silence_ns: int | None = None
    jitter_ns: int = 0
    fd: bool = False
    event: bool = False
    assumption: str = ""

    @property
    def worst(self) -> WireBits:
        """The longest frame."""
        return worst_bits(self.length, extended=self.extended, fd=self.fd)

    @property
    def best(self) -> WireBits:
        """The frame without stuff bits."""
        return best_bits(self.length, extended=self.extended, fd=self.fd)


@dataclass(frozen=True)
class MessageSet:
    """The messages of a file, most urgent first; `left_out`: name -> why it does not count.

    `mailboxes`: nodes whose most urgent frame always competes, by the DBC's TransmitQueue.
    """

    source: str
    messages: tuple[BusMessage, ...]
    left_out: Mapping[str, str]
    mailboxes: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Reading:
    """How a DBC is read where it leaves something open; times in ns.

    `jitter_ns` holds for every message. `event_interval_ns`: the shortest time between two frames of an event
    message; None: the cycle of its sender. `silence`: the deadline is the silence limit where there is one,
    instead of the cycle. `cycles_ns` replaces cycles by message name. `fd`: all frames are CAN FD.
    """

    jitter_ns: int = 0
    event_interval_ns: int | None = None
    silence: bool = False
    cycles_ns: Mapping[str, int] | None = None
    fd: bool = False


def priority(can_id: int, extended: bool) -> tuple[int, bool, int]:
    """Sorts as arbitration does: base identifier, standard before extended, identifier extension."""
    return (can_id >> 18, True, can_id & 0x3FFFF) if extended else (can_id, False, 0)


def message_set(path: Path | None = None, reading: Reading | None = None) -> MessageSet:
    """The message set of a DBC file; default: the shipped ato_bench.dbc.

    ContractError: no such file, not a DBC. MessageSetError: `cycles_ns` names a message that is not there,
    an event has no interval that could be assumed, nothing is left, two messages share an identifier.
    """
    path = Path(dbc.path() if path is None else path)
    reading = reading or Reading()
    given = dict(reading.cycles_ns or {})
    database = read_database(path)
    found = database.messages
    unknown = sorted(set(given) - {message.name for message in found})
    if unknown:
        raise MessageSetError(
            f"{path.name}: no message {unknown[0]!r}; it has {', '.join(m.name for m in found)}"
        )
    left_out: dict[str, str] = {}
    kept: list[BusMessage] = []
    for message in found:
        if message.send_type == LOCKSTEP:
            left_out[message.name] = "sent in lockstep only"
        elif message.length > FD_LENGTHS[-1]:
            left_out[message.name] = f"{message.length} bytes fit no CAN frame"
        elif message.name == "VECTOR__INDEPENDENT_SIG_MSG":
            left_out[message.name] = "holds signals that belong to no message"
        else:
            kept.append(_message(message, reading, given))
    if not kept:
        raise MessageSetError(f"{path.name}: no message to analyse")
    kept = [_with_event_period(message, kept, reading, path.name) for message in kept]
    kept.sort(key=lambda message: priority(message.can_id, message.extended))
    for one, other in pairwise(kept):
        if (one.can_id, one.extended) == (other.can_id, other.extended):
            raise MessageSetError(
                f"{path.name}: {one.name} and {other.name} have the same identifier 0x{one.can_id:X}"
            )
    mailboxes = frozenset(node.name for node in database.nodes if _has_mailboxes(node))
    return MessageSet(path.name, tuple(kept), left_out, mailboxes)


def _has_mailboxes(node: Node) -> bool:
    attributes = node.dbc.attributes if node.dbc is not None else {}
    value = getattr(attributes.get(TRANSMIT_QUEUE), "value", "")
    return str(value).lower() == "priority"


def _message(message: Message, reading: Reading, given: Mapping[str, int]) -> BusMessage:
    cycle = given.get(message.name, round((message.cycle_time or 0) * NS_PER_MS))
    interval = round(message_attribute(message, MINIMUM_INTERVAL, 0) * NS_PER_MS)
    event = not cycle
    silence = round(message_attribute(message, "TimeoutMs", 0) * NS_PER_MS) or None
    period = cycle or interval
    return BusMessage(
        name=message.name,
        can_id=message.frame_id,
        extended=message.is_extended_frame,
        length=message.length,
        sender=next((name for name in message.senders if name != NOBODY), ""),
        period_ns=period,
        deadline_ns=silence if silence and reading.silence else period,
        silence_ns=silence,
        jitter_ns=reading.jitter_ns,
        fd=reading.fd or message.is_fd or message.length > MAX_CLASSIC_LENGTH,
        event=event,
    )


def _with_event_period(
    message: BusMessage, others: list[BusMessage], reading: Reading, source: str
) -> BusMessage:
    """An event message without a minimum interval gets one that is named, instead of being left out."""
    if message.period_ns:
        return message
    period = reading.event_interval_ns
    why = f"at most one in {_ms(period or 0)} ms (as asked)"
    if period is None:
        cycles = [m.period_ns for m in others if m.sender == message.sender and not m.event]
        whose = f"the shortest cycle of {message.sender}"
        if not cycles or not message.sender:
            cycles, whose = [m.period_ns for m in others if not m.event], "the shortest cycle of the file"
        if not cycles:
            raise MessageSetError(
                f"{source}: {message.name} has neither a cycle time nor {MINIMUM_INTERVAL}, nor has any other"
                " message: give --event-interval MS"
            )
        period = min(cycles)
        why = f"at most one in {_ms(period)} ms ({whose})"
    return replace(message, period_ns=period, deadline_ns=message.deadline_ns or period, assumption=why)


def _ms(time_ns: int) -> str:
    return f"{time_ns / NS_PER_MS:g}"
