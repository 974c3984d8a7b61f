"""Which messages share a transmit queue: what the analysis takes for each node, and how it says so."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from hil.canbus.analysis.message_set import MessageSet, MessageSetError

QueueKind = Literal["auto", "fifo", "priority"]

BENCH_TOGETHER = (("TCU", "BCU", "ODO", "ATP"),)
"""Nodes of the bench that one process plays, with one client of the bus: one queue."""


@dataclass(frozen=True)
class Queues:
    """How nodes hand their frames to arbitration.

    `kind`: "fifo", one first-in first-out queue per node, as python-can's clients, the local bus and
    SocketCAN's pfifo_fast have; "priority", the most urgent frame of a node always competes, as with a
    mailbox per message; "auto", the first, but the second for nodes whose TransmitQueue in the DBC says so.
    `together`: nodes that share a queue.
    """

    kind: QueueKind = "auto"
    together: tuple[tuple[str, ...], ...] = ()

    def of(self, messages: MessageSet) -> list[str | None]:
        """The queue of each message; None: a mailbox of its own, as a message without sender has.

        MessageSetError: `together` names a node that sends nothing, twice, or one that has mailboxes.
        """
        senders = {message.sender for message in messages.messages if message.sender}
        mailboxes = self._mailboxes(messages)
        counted = Counter(name for group in self.together for name in group)
        for name, times in counted.items():
            if name not in senders:
                has = ", ".join(sorted(senders))
                raise MessageSetError(f"--together {name}: no such sender in {messages.source}; it has {has}")
            if times > 1:
                raise MessageSetError(f"--together {name}: named twice; a node has one queue")
            if name in mailboxes:
                raise MessageSetError(
                    f"--together {name}: it has a mailbox per message, so no queue to share"
                )
        queue = {name: "+".join(group) for group in self.together for name in group}
        return [
            None if not m.sender or m.sender in mailboxes else queue.get(m.sender, m.sender)
            for m in messages.messages
        ]

    def describe(self, messages: MessageSet) -> list[str]:
        """What is assumed, a line each, for people."""
        if self.kind == "priority":
            return ["queues: each node hands its most urgent frame to arbitration (a mailbox per message)"]
        names = self.of(messages)
        shared = sorted({name for name in names if name}, key=names.index)
        mailboxes = sorted(self._mailboxes(messages))
        lines = [f"queues: first in, first out, one each for {', '.join(shared)}"] if shared else []
        if mailboxes:
            lines.append(f"queues: the most urgent frame first at {', '.join(mailboxes)} (TransmitQueue)")
        if any(not m.sender for m in messages.messages):
            lines.append("queues: messages without a sender have a mailbox each")
        return lines

    def _mailboxes(self, messages: MessageSet) -> frozenset[str]:
        """Nodes whose most urgent frame always competes."""
        if self.kind == "priority":
            return frozenset(message.sender for message in messages.messages)
        return messages.mailboxes if self.kind == "auto" else frozenset()


def groups_of(texts: Iterable[str]) -> tuple[tuple[str, ...], ...]:
    """Groups as options name them, "TCU,BCU"; "none" and "" name no group."""
    groups: Sequence[tuple[str, ...]] = [
        tuple(name.strip() for name in text.split(",") if name.strip()) for text in texts if text != "none"
    ]
    return tuple(group for group in groups if group)
