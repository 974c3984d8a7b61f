"""Local bus, the hub's side of one connection: who is there, and what waits for it."""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
import time
from typing import Any

from hil.canbus.local.filters import Acceptance
from hil.canbus.local.wire import WireError

_PIECE_BYTES = 2048
"""Sent at once. The kernel accounts for what a client has read by such pieces: about 85 classic frames."""


class Connection:
    """One client of the hub, or one who has not said HELLO yet (`number` 0)."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.number = 0
        self.name = "?"
        self.pid = 0
        self.receive_own = False
        self.fd = False
        self.acceptance: Acceptance | None = None
        self.partial = b""  # start of a record whose rest has not arrived
        self.backlog = bytearray()
        self.feeders: set[int] = set()  # numbers of those who added to the backlog
        self.at_mark = False  # the backlog is so long that they may not go on
        self.deaf = False  # writing failed; what it sent before that is still read
        self.events = selectors.EVENT_READ
        self.frames_sent = 0
        self._progress_s = 0.0
        self._unread = 0

    def __str__(self) -> str:
        return f"'{self.name}' (process {self.pid})" if self.number else "without a name"

    def introduce(self, number: int, content: dict[str, Any]) -> None:
        """Take over what a HELLO says; raises WireError when it makes no sense."""
        try:
            self.pid = int(content.get("pid", 0))
        except (TypeError, ValueError, OverflowError):
            raise WireError("HELLO without a process id") from None
        self.name = " ".join(str(content.get("name", "?")).split())[:80]
        self.receive_own = bool(content.get("receive_own"))
        self.fd = bool(content.get("fd"))
        self.filter(content)
        self.number = number

    def filter(self, content: dict[str, Any]) -> None:
        """Take over the filters of a HELLO or FILTERS; raises WireError when they make no sense."""
        filters = content.get("filters")
        try:
            self.acceptance = None if filters is None else Acceptance(filters)
        except (TypeError, ValueError, OverflowError):
            raise WireError("filters are not a list of (id, mask, extended)") from None

    def deliver(self, records: bytes | bytearray) -> bool:
        """Hand over records now, or keep them in the backlog; True when there is a backlog to mind."""
        if self.deaf:
            return False
        if not self.backlog:
            taken = self._send(records)
            if taken == len(records) or self.deaf:
                return False
            self.backlog += memoryview(records)[taken:]
        else:
            self.backlog += records
        return True

    def flush(self) -> None:
        """Hand over as much of the backlog as is taken now."""
        taken = self._send(self.backlog)
        if self.deaf:
            self.backlog.clear()
        elif taken:
            del self.backlog[:taken]
            self.note_progress()

    def note_progress(self) -> None:
        """The client is alive now: count its silence from here."""
        self._progress_s = time.monotonic()
        self._unread = self.unread_bytes()

    def silence_s(self) -> float:
        """For how long the client has read nothing (less than a piece)."""
        # The kernel asks for more only when most of its buffer is free; a slow reader shows here first.
        if self.unread_bytes() < self._unread:
            self.note_progress()
        return time.monotonic() - self._progress_s

    def unread_bytes(self) -> int:
        """What the kernel keeps for the client, with the kernel's overhead; 0 where it does not say."""
        with contextlib.suppress(ImportError, AttributeError, OSError):
            import fcntl
            import termios

            return int(struct.unpack("i", fcntl.ioctl(self.sock, termios.TIOCOUTQ, bytes(4)))[0])
        return 0

    def _send(self, records: bytes | bytearray) -> int:
        """How many bytes were taken."""
        size = len(records)
        taken = 0
        try:
            if size <= _PIECE_BYTES:
                return self.sock.send(records)
            with memoryview(records) as view:
                while taken < size:
                    taken += self.sock.send(view[taken : taken + _PIECE_BYTES])
        except BlockingIOError:
            pass
        except OSError:
            self.deaf = True
        return taken
