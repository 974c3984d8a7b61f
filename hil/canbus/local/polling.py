"""Waiting for traffic: look again for a moment before going to sleep, where that has paid of late.

To wake a sleeping process takes 10 to 50 us, several times what the bus itself needs for a frame. While
frames follow one another without a pause, who waits for the next one therefore looks again and again, for a
bounded time. Traffic with pauses of milliseconds, as of nodes with a cycle, never gets there: it costs no
processor time. This is what the kernel's haltpoll governor does for virtual processors.
"""

from __future__ import annotations

import os
import select
import selectors
import socket
import time
from typing import Any

from hil.canbus.local import wire

POLL_NS = 200_000
"""Polled for so long at most before sleeping; a wait that takes less is a short one."""

SHORT_WAITS = 16
"""So many short waits in a row, then polling begins."""

MAX_SHORT_WAITS = 4096
WORTH_WAITS = 32
"""Polling that served so many waits was worth the vain one at its end: as many wake-ups were saved."""

_READ, _WRITE = selectors.EVENT_READ, selectors.EVENT_WRITE
_MOST_AT_ONCE = 64


class Polling:
    """Decides, from how long the waits before took, for how long the next one polls: `limit_ns`.

    That is 0 (sleep at once) or POLL_NS. A wait that was long ends polling. When little was polled for before
    it, twice as many short waits are asked for the next time.
    """

    __slots__ = ("_needed", "_polled", "_short", "limit_ns")

    def __init__(self) -> None:
        self.limit_ns = 0
        self._polled = 0
        self._short = 0
        self._needed = SHORT_WAITS

    def waited(self, wait_ns: int) -> None:
        """A wait took so long, polled or slept."""
        if wait_ns > POLL_NS:
            if self.limit_ns:
                worth_it = self._polled >= WORTH_WAITS
                self._needed = SHORT_WAITS if worth_it else min(2 * self._needed, MAX_SHORT_WAITS)
                self.limit_ns = self._polled = 0
            self._short = 0
        elif self.limit_ns:
            self._polled += 1
        else:
            self._short += 1
            if self._short >= self._needed:
                self._short = 0
                self.limit_ns = POLL_NS if may_poll() else 0

    def wait_readable(self, sock: socket.socket, timeout_s: float | None) -> None:
        """Wait until `sock` can be read or has ended, at most `timeout_s` (None: for ever)."""
        begun_ns = time.monotonic_ns()
        number = sock.fileno()
        if self.limit_ns and number >= 0 and (timeout_s is None or timeout_s * 1e9 > self.limit_ns):
            watch = select.poll()
            watch.register(number, select.POLLIN)
            os.sched_yield()  # the hub may be waiting for this very processor
            until_ns = begun_ns + self.limit_ns
            while not watch.poll(0):
                if time.monotonic_ns() >= until_ns:
                    wire.wait_readable(sock, timeout_s)
                    break
                os.sched_yield()
        else:
            wire.wait_readable(sock, timeout_s)
        self.waited(time.monotonic_ns() - begun_ns)

    def select(self, selector: selectors.BaseSelector | Epoll, timeout_s: float | None) -> list[Any]:
        """What `selector` has ready; waits for it up to `timeout_s` (None: for ever)."""
        begun_ns = time.monotonic_ns()
        ready: list[Any] = []
        if self.limit_ns and timeout_s != 0:
            until_ns = begun_ns + self.limit_ns
            while not (ready := selector.select(0)) and time.monotonic_ns() < until_ns:
                os.sched_yield()
        if not ready:
            ready = selector.select(timeout_s)
        self.waited(time.monotonic_ns() - begun_ns)
        return ready


def may_poll() -> bool:
    """Whether polling may pay: real-time priority, and a second processor for who is waited for.

    A process without such a priority would spend its share of the time, or its container's, for nothing.
    """
    try:
        realtime = os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR)
        return realtime and len(os.sched_getaffinity(0)) > 1
    except (AttributeError, OSError):
        return False


def fast_selector() -> selectors.BaseSelector | Epoll:
    """The selector that costs least here."""
    return Epoll() if hasattr(select, "epoll") else selectors.DefaultSelector()


class Epoll:
    """What the hub uses of `selectors.EpollSelector`, with less to do for each event."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._keys: dict[int, selectors.SelectorKey] = {}

    def register(self, file: Any, events: int, data: Any = None) -> None:
        """Watch a socket or file number for `selectors.EVENT_READ`, `EVENT_WRITE` or both."""
        number = _number(file)
        self._epoll.register(number, _mask(events))
        self._keys[number] = selectors.SelectorKey(file, number, events, data)

    def modify(self, file: Any, events: int, data: Any = None) -> None:
        """Watch it for other events."""
        number = _number(file)
        self._epoll.modify(number, _mask(events))
        self._keys[number] = selectors.SelectorKey(file, number, events, data)

    def unregister(self, file: Any) -> None:
        """Watch it no longer."""
        number = _number(file)
        del self._keys[number]
        self._epoll.unregister(number)

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Those that are ready; waits up to `timeout` s (None: for ever), in whole milliseconds upwards."""
        keys = self._keys
        found = self._epoll.poll(timeout, _MOST_AT_ONCE)
        return [
            (key := keys[number], _READ if mask == select.EPOLLIN else _events(mask) & key.events)
            for number, mask in found
        ]

    def close(self) -> None:
        """Watch nothing any more."""
        self._epoll.close()
        self._keys.clear()


def _number(file: Any) -> int:
    return file if isinstance(file, int) else int(file.fileno())


def _mask(events: int) -> int:
    mask = select.EPOLLIN if events & _READ else 0
    return mask | select.EPOLLOUT if events & _WRITE else mask


def _events(mask: int) -> int:
    # An error or a hang-up is found out by whoever reads or writes next.
    events = _READ if mask & ~select.EPOLLOUT else 0
    return events | _WRITE if mask & ~select.EPOLLIN else events
