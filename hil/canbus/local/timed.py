"""Local bus with a bit rate: frames wait for the wire, and arrive when their last bit was sent.

`TimedExchange` stands between the hub's sockets and the model of the wire (`medium.py`). The model's time is
exact; a hub that wakes up late delivers late, with the model's time stamps.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import selectors
import socket
import sys
import time
from collections.abc import Callable
from typing import Any

from hil.canbus.local.connection import Connection
from hil.canbus.local.credit import sent_record
from hil.canbus.local.exchange import CLOCK_STEP_NS, Exchange
from hil.canbus.local.medium import Completed, Medium, Reported, WireFrame
from hil.canbus.local.rates import WireOptions
from hil.canbus.local.wire import ERROR, FD, HEADER, HEADER_SIZE, STAMP, WireError

SPIN_NS = 60_000
"""With a real-time priority the hub watches the clock for the last part of a frame instead of sleeping."""

_LOOK_S = 0.2  # how often the hub looks whether a client that it holds has ended
_CLOCK_SLIP_NS = 1_000_000  # the wall clock was set: follow it when the bus is idle
_PR_SET_TIMERSLACK = 29  # linux/prctl.h


def precise_selector() -> selectors.BaseSelector:
    """A selector whose timeout resolves microseconds; epoll's would resolve milliseconds."""
    return selectors.SelectSelector()


class TimedExchange(Exchange):
    """Clients on a wire: their frames go through a `Medium` before they are handed to the others."""

    def __init__(
        self,
        high_water_bytes: int,
        changed: Callable[[Connection | None], None],
        options: WireOptions,
    ) -> None:
        super().__init__(high_water_bytes, changed)
        self._medium = Medium(
            options.bitrate,
            options.data_bitrate,
            listeners=0,
            restart_ns=options.restart_ms * 1_000_000 or None,
            seed=options.seed,
        )
        self._tx_queue_frames = options.tx_queue_frames
        # A client counts its frames itself and stops at its limit: this is for those that do not.
        self._hold_frames = 2 * options.tx_queue_frames
        self._done: dict[int, int] = {}  # frames by client number: sent, or dropped at bus-off
        self._full: set[int] = set()
        self._offset_ns = clock_offset_ns()
        self._last_ns = 0
        self._spin_ns = 0
        _ask_for_exact_timers()

    def admit(self, client: Connection) -> dict[str, Any]:
        """A client joins the bus; what its WELCOME says of the wire."""
        super().admit(client)
        self._spin_ns = SPIN_NS if _is_realtime() else 0  # the priority comes after the start
        self._medium.join(client.number, time.monotonic_ns())
        self._done[client.number] = 0
        medium = self._medium
        return {
            "bitrate": medium.bitrate,
            "data_bitrate": medium.data_bitrate,
            "tx_queue": self._tx_queue_frames,
        }

    def remove(self, client: Connection) -> None:
        """A client leaves; what it has sent is still on its way."""
        super().remove(client)
        if client.number:
            self._medium.leave(client.number, time.monotonic_ns())
            self._done.pop(client.number, None)
            self._full.discard(client.number)

    def held(self, client: Connection) -> bool:
        """Whether no frames may be taken from `client` now: others are slow, or its queue is full."""
        return client.number in self._full or super().held(client)

    def forward(
        self, sender: Connection, records: bytearray, count: int, stamp_ns: int, *, with_fd: bool
    ) -> None:
        """Queue `count` records of `sender` for the wire; they are stamped at the end of each frame."""
        now_ns = time.monotonic_ns()
        medium = self._medium
        if medium.next_event_ns() is None:
            self._follow_clock(now_ns)
        refused = offset = 0
        while offset < len(records):
            _, can_id, length, flags, dlc = HEADER.unpack_from(records, offset)
            end = offset + HEADER_SIZE + length
            if can_id & ERROR:  # an error frame that a program makes up is never on a wire
                self._hand_over(sender, records[offset:end], self._offset_ns + now_ns, with_fd=False)
                self._done[sender.number] += 1
                refused += 1
            else:
                frame = WireFrame(can_id, bytes(records[offset + HEADER_SIZE : end]), flags, dlc, sender)
                try:
                    taken = medium.submit(sender.number, frame, now_ns)
                except ValueError as error:
                    raise WireError(str(error)) from None
                if not taken:
                    self._done[sender.number] += 1
                    refused += 1
            offset = end
        if refused:
            self.deliver(sender, sent_record(self._done[sender.number]))
        if medium.pending(sender.number) >= self._hold_frames and sender.number not in self._full:
            self._full.add(sender.number)
            self._changed(sender)

    def wait_s(self, timeout_s: float | None) -> float | None:
        """How long the hub may sleep: `timeout_s` (None: for ever), or until the wire does something."""
        due_ns = self._medium.next_event_ns()
        if self._full:
            timeout_s = _LOOK_S if timeout_s is None else min(_LOOK_S, timeout_s)
        if due_ns is None:
            return timeout_s
        until_s = max(0, due_ns - self._spin_ns - time.monotonic_ns()) / 1e9
        return until_s if timeout_s is None else min(timeout_s, until_s)

    def advance(self) -> None:
        """Hand over what the wire has done by now."""
        if self._full:
            self._release_gone()
        due_ns = self._medium.next_event_ns()
        if due_ns is None:
            return
        now_ns = time.monotonic_ns()
        if due_ns <= now_ns:
            self._let_pass(now_ns)

    def finish(self) -> None:
        """Hand over all that still waits for the wire, without waiting."""
        for _ in range(1_000_000):
            due_ns = self._medium.next_event_ns()
            if due_ns is None:
                break
            self._let_pass(due_ns)

    def disturb(self, content: dict[str, Any]) -> None:
        """Make errors on the wire: keywords of `Disturbance`, or {"clear": true}; raises WireError."""
        if content.get("clear"):
            self._medium.corrupt_no_more()
            return
        try:
            self._medium.corrupt(**content)
        except (TypeError, ValueError) as error:
            raise WireError(f"no disturbance: {error}") from None

    def statistics(self) -> dict[str, Any]:
        """Frames, clients, load of the wire, messages, error counters."""
        self._let_pass(time.monotonic_ns())
        known = super().statistics()
        wire = self._medium.statistics()
        nodes = {entry.pop("node"): entry for entry in wire.pop("nodes")}
        for client in known["clients"]:
            client.update(nodes.get(str(client["number"]), {}))
        return known | wire

    def _release_gone(self) -> None:
        """Read on from those that were held and have ended meanwhile: nothing else would tell the hub."""
        for client in [member for member in self.members if member.number in self._full]:
            if _has_ended(client.sock):
                self._full.discard(client.number)
                self._changed(client)

    def _let_pass(self, now_ns: int) -> None:
        told: dict[int, Connection] = {}
        for event in self._medium.events(now_ns):
            stamp_ns = self._offset_ns + event[0]
            if isinstance(event, Reported):
                for client in self.members:
                    if client.number == event.node:
                        classes, data = event.notice
                        stamp_ns = self._next_stamp(stamp_ns)
                        self.deliver(client, HEADER.pack(stamp_ns, ERROR | classes, 8, 0, 8) + data)
                continue
            sender: Connection = event.frame.tag
            if isinstance(event, Completed):
                can_id, payload, flags, dlc, _ = event.frame
                record = bytearray(HEADER.pack(0, can_id, len(payload), flags, dlc or 0)) + payload
                self._hand_over(sender, record, stamp_ns, with_fd=bool(flags & FD))
            if sender.number in self._done:
                self._done[sender.number] += 1
                told[sender.number] = sender
        for number, sender in told.items():
            if number not in self._done:
                continue
            self.deliver(sender, sent_record(self._done[number]))
            if number in self._full and self._medium.pending(number) < self._hold_frames:
                self._full.discard(number)
                self._changed(sender)

    def _hand_over(self, sender: Connection, record: bytearray, stamp_ns: int, *, with_fd: bool) -> None:
        stamp_ns = self._next_stamp(stamp_ns)
        STAMP.pack_into(record, 0, stamp_ns)
        super().forward(sender, record, 1, stamp_ns, with_fd=with_fd)

    def _next_stamp(self, stamp_ns: int) -> int:
        """Time stamps increase; what happens in the same instant follows in steps of 1 ns."""
        self._last_ns = max(stamp_ns, self._last_ns + 1)
        return self._last_ns

    def _follow_clock(self, now_ns: int) -> None:
        if abs(time.time_ns() - now_ns - self._offset_ns) <= _CLOCK_SLIP_NS:
            return
        offset_ns = clock_offset_ns()  # the clock was set, or the hub was held up between the two looks
        if abs(offset_ns - self._offset_ns) > _CLOCK_SLIP_NS:
            if offset_ns < self._offset_ns - CLOCK_STEP_NS:
                self._last_ns = 0
            self._offset_ns = offset_ns


def clock_offset_ns() -> int:
    """CLOCK_REALTIME minus CLOCK_MONOTONIC [ns]: the reading of a few that took the shortest time."""
    readings = []
    for _ in range(3):
        before_ns = time.monotonic_ns()
        wall_ns = time.time_ns()
        after_ns = time.monotonic_ns()
        readings.append((after_ns - before_ns, wall_ns - (before_ns + after_ns) // 2))
    return min(readings)[1]


def _has_ended(sock: socket.socket) -> bool:
    """Whether the other side has closed, even when data of it wait."""
    if not hasattr(select, "poll"):
        return False
    poll = select.poll()
    poll.register(sock, 0)  # a hang-up is always told
    return bool(poll.poll(0))


def _is_realtime() -> bool:
    """Whether this process runs with a real-time priority."""
    with contextlib.suppress(AttributeError, OSError):
        return os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR)
    return False


def _ask_for_exact_timers() -> None:
    """Without it the kernel lets an ordinary process sleep up to 50 us too long."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
