"""Local bus, who is on the bus and gets what: one order for all, and who is held when somebody is slow."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from hil.canbus.local import wire
from hil.canbus.local.connection import Connection
from hil.canbus.local.filters import marked_own, select_records

CLOCK_STEP_NS = 1_000_000_000  # a clock set back further than this is followed
_CLIENTS_TOLD = 100  # in the statistics, which have to fit a control record


class Exchange:
    """The clients that have joined.

    Frames go to all members but the sender, in the order of `forward`. What a member does not take at once
    stays in its backlog. A backlog at the high-water mark holds everybody who has added to it, until half of
    it is taken. `changed` is called with each connection whose events have to be looked at again (None: all).
    """

    def __init__(self, high_water_bytes: int, changed: Callable[[Connection | None], None]) -> None:
        self.members: list[Connection] = []
        self.frames = 0
        self.at_mark = 0
        """Members whose backlog is at the high-water mark."""
        self._high_water = high_water_bytes
        self._changed = changed
        self._last_stamp_ns = 0

    def admit(self, client: Connection) -> dict[str, Any]:
        """A client joins; what its WELCOME says beyond its number."""
        self.members.append(client)
        return {}

    def begin_stamps(self) -> int:
        """The time before that of the next frame, CLOCK_REALTIME ns; never earlier than the last frame's."""
        now_ns = time.time_ns()
        last_ns = self._last_stamp_ns
        return now_ns - 1 if now_ns > last_ns or now_ns < last_ns - CLOCK_STEP_NS else last_ns

    def forward(
        self, sender: Connection, records: bytearray, count: int, stamp_ns: int, *, with_fd: bool
    ) -> None:
        """Hand over `count` records, the last one stamped `stamp_ns`; `with_fd`: CAN FD is among them."""
        self._last_stamp_ns = stamp_ns
        self.frames += count
        sender.frames_sent += count
        for client in self.members:
            chosen: bytes | bytearray = records
            if client is sender:
                if not client.receive_own:
                    continue
                chosen = marked_own(records)
            acceptance = client.acceptance
            if acceptance is not None or (with_fd and not client.fd):
                chosen = select_records(chosen, acceptance, fd=client.fd)
                if not chosen:
                    continue
            if client.deliver(chosen):
                if sender.number not in client.feeders:
                    client.feeders.add(sender.number)
                    if client.at_mark:
                        self._changed(sender)
                self._mind(client)

    def tell(self, client: Connection, code: wire.Control, content: dict[str, Any]) -> None:
        """Hand over a control record, behind the frames that are on their way."""
        self.deliver(client, wire.control_record(code, content))

    def deliver(self, client: Connection, records: bytes | bytearray) -> None:
        """Hand over records, or keep them."""
        if client.deliver(records):
            self._mind(client)

    def flush(self, client: Connection) -> None:
        """Hand over what is kept, as far as it is taken."""
        client.flush()
        self._mind(client)

    def held(self, client: Connection) -> bool:
        """Whether no frames may be taken from `client` now: some of late went to a backlog at the mark."""
        if not self.at_mark:
            return False
        return any(other.at_mark and client.number in other.feeders for other in self.members)

    def stalled(self, limit_s: float) -> tuple[list[Connection], float | None]:
        """The members at the mark that read nothing for `limit_s`, and when to look again (s from now)."""
        silent = [(client, client.silence_s()) for client in self.members if client.at_mark]
        gone = [client for client, silence_s in silent if silence_s >= limit_s]
        rest = [limit_s - silence_s for _, silence_s in silent if silence_s < limit_s]
        return gone, min(rest, default=None)

    def remove(self, client: Connection) -> None:
        """Forget a member; those it held go on."""
        if client in self.members:
            self.members.remove(client)
        if client.at_mark:
            client.at_mark = False
            self.at_mark -= 1
            self._changed(None)

    def statistics(self) -> dict[str, Any]:
        """Frames and clients, for a `STATISTICS` record."""
        return {
            "frames": self.frames,
            "backlog_bytes": sum(len(client.backlog) for client in self.members),
            "high_water_bytes": self._high_water,
            "clients": [
                {
                    "number": client.number,
                    "name": client.name,
                    "pid": client.pid,
                    "frames_sent": client.frames_sent,
                    "backlog_bytes": len(client.backlog),
                    "unread_bytes": client.unread_bytes(),
                    "stalled": client.at_mark,
                }
                for client in self.members[:_CLIENTS_TOLD]
            ],
        }

    def _mind(self, client: Connection) -> None:
        """Follow a change of a client's backlog."""
        limit = self._high_water // 2 if client.at_mark else self._high_water
        at_mark = len(client.backlog) >= limit
        if not client.backlog or (client.at_mark and not at_mark):
            client.feeders.clear()
        if at_mark == client.at_mark:
            self._changed(client)
            return
        client.at_mark = at_mark
        self.at_mark += 1 if at_mark else -1
        if at_mark:
            client.note_progress()
        self._changed(None)
