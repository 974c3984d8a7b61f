"""Local bus, the hub: takes every client's frames, stamps them, hands them to all others in one order.

One thread, one `select`. Nothing is ever dropped: what a client has not read yet waits here (its
backlog). When a backlog passes the high-water mark, the hub stops reading from everybody who added to
it, so their sockets fill and their `send` times out; when the owner of the backlog has then read
nothing for `stall_limit_s`, it is removed.

Without a bit rate frames go as fast as they can, as on vcan; with one they take their time on the wire
(`timed.py`).
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import sys
import time
from collections import deque
from typing import TYPE_CHECKING, Any

from hil.canbus.local import wire
from hil.canbus.local.address import Claim
from hil.canbus.local.connection import Connection
from hil.canbus.local.exchange import Exchange
from hil.canbus.local.polling import Epoll, Polling, fast_selector
from hil.canbus.local.rates import WireOptions, refused_bitrate
from hil.canbus.local.wire import CONTROL, FD, HEADER, HEADER_SIZE, STAMP, Control, WireError

if TYPE_CHECKING:
    from hil.canbus.local.timed import TimedExchange

HIGH_WATER_BYTES = 8 << 20
"""About 350,000 classic frames: minutes of a bench's traffic, a second of a flood."""

STALL_LIMIT_S = 10.0
FIRST_CLIENT_S = 10.0  # how long a lingering hub waits for its first client

_CHUNK_BYTES = 32 << 10  # read from one client before the next one has its turn
_READ, _WRITE = selectors.EVENT_READ, selectors.EVENT_WRITE
_FAREWELL_S = 0.5  # to hand out what waits when the hub ends


class Hub:
    """The hub of one channel.

    Raises `address.ChannelTakenError` when the channel has a hub already, `address.AddressError` when it
    cannot have one. `serve` runs until `stop`, or until `linger_s` after the last client left (None: for
    ever).
    """

    def __init__(
        self,
        channel: str,
        *,
        timing: WireOptions | None = None,
        linger_s: float | None = None,
        high_water_bytes: int = HIGH_WATER_BYTES,
        stall_limit_s: float = STALL_LIMIT_S,
    ) -> None:
        self.channel = channel
        self.claim = Claim(channel)
        self._timing = timing
        self._linger_s = linger_s
        self._stall_limit_s = stall_limit_s
        self._connections: dict[int, Connection] = {}
        self._timed: TimedExchange | None = None
        self._selector: selectors.BaseSelector | Epoll
        if timing is None:
            self._exchange = Exchange(high_water_bytes, self._set_events)
            self._selector = fast_selector()
        else:
            from hil.canbus.local.timed import TimedExchange, precise_selector

            self._exchange = self._timed = TimedExchange(high_water_bytes, self._set_events, timing)
            self._selector = precise_selector()
        self._wake_read, self.wake_write = socket.socketpair()
        self._wake_read.setblocking(False)
        self.wake_write.setblocking(False)
        self._polling = Polling()
        self._parent: int | None = None
        self._ending: str | None = None
        self._empty_since_s = time.monotonic() + max(0.0, FIRST_CLIENT_S - (linger_s or 0.0))
        self._joined = 0
        self._started_s = time.monotonic()
        self._removed: deque[tuple[int, str]] = deque(maxlen=64)
        self._selector.register(self.claim.listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._wake_read, selectors.EVENT_READ, self._woken)

    def stop(self, reason: str) -> None:
        """End `serve` soon; may be called from another thread or from a signal handler."""
        self._ending = self._ending or reason
        with contextlib.suppress(OSError):
            self.wake_write.send(b"\0")

    def watch_parent(self, pipe: int) -> None:
        """End when `pipe` (a file number) is at its end; raises OSError when it cannot be waited for."""
        os.set_blocking(pipe, False)
        self._selector.register(pipe, selectors.EVENT_READ, self._parent_spoke)
        self._parent = pipe

    def serve(self) -> str:
        """Serve the clients until the end; returns why it ended. The channel is free afterwards."""
        self.claim.write_pid()
        try:
            while self._ending is None:
                held = self._exchange.at_mark or not self._connections
                self._turn(self._remove_stalled() if held else None)
                if not self._connections and self._linger_left_s() == 0.0:
                    self._ending = "nobody was left"
            # What reached the hub before the end is still delivered.
            deadline_s = time.monotonic() + _FAREWELL_S / 2
            while self._turn(0.0) and time.monotonic() < deadline_s:
                pass
            if self._timed is not None:
                self._timed.finish()
        finally:
            self._close(self._ending or "an internal error")
        return self._ending

    def statistics(self) -> dict[str, Any]:
        """What the hub knows of itself: frames, clients, backlogs, who was removed and why."""
        return {
            "channel": self.channel,
            "pid": os.getpid(),
            "bitrate": None,
            "uptime_s": round(time.monotonic() - self._started_s, 3),
            "removed": [{"number": number, "reason": reason} for number, reason in self._removed],
            **self._exchange.statistics(),
        }

    def _turn(self, timeout_s: float | None) -> int:
        """Wait for sockets and serve those that are ready; returns how many."""
        if self._timed is None:
            ready = self._polling.select(self._selector, timeout_s)
        else:
            ready = self._selector.select(self._timed.wait_s(timeout_s))
        for key, events in ready:
            client = key.data
            if not isinstance(client, Connection):
                client()
                continue
            # Once more with what it is watched for now: one before it may have had it held or removed.
            if events & _WRITE & client.events:
                self._exchange.flush(client)
            if events & _READ & client.events:
                self._read(client)
        if self._timed is not None:
            self._timed.advance()
        return len(ready)

    def _linger_left_s(self) -> float | None:
        """How long the hub still waits for somebody to come; None: for ever, or somebody is there."""
        if self._linger_s is None or self._connections:
            return None
        return max(0.0, self._empty_since_s + self._linger_s - time.monotonic())

    def _accept(self) -> None:
        sock = self.claim.accept()
        if sock is None:
            return
        client = Connection(sock)
        self._connections[sock.fileno()] = client
        self._selector.register(sock, client.events, client)

    def _woken(self) -> None:
        with contextlib.suppress(OSError):
            self._wake_read.recv(1024)

    def _parent_spoke(self) -> None:
        pipe = self._parent
        if pipe is not None and not os.read(pipe, 1024):
            self._selector.unregister(pipe)
            self._parent = None
            self.stop("the process that started it is gone")

    def _read(self, client: Connection) -> None:
        try:
            chunk = client.sock.recv(_CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        if not chunk:
            self._remove(client, "is gone without a goodbye" if client.number else None)
            return
        try:
            self._digest(client, bytearray(client.partial + chunk if client.partial else chunk))
        except WireError as error:
            self._exchange.tell(
                client, Control.ENDED, {"reason": f"the hub could not read what it sent: {error}"}
            )
            self._remove(client, f"was removed: {error}")

    def _digest(self, client: Connection, records: bytearray) -> None:
        """Stamp the frames in `records` and forward them; act on control records in between."""
        unpack_from, pack_into = HEADER.unpack_from, STAMP.pack_into
        size = len(records)
        stamp_ns = self._exchange.begin_stamps()
        first = offset = count = 0
        with_fd = False
        while offset + HEADER_SIZE <= size:
            _, code, length, flags, _ = unpack_from(records, offset)
            end = offset + HEADER_SIZE + length
            if end > size:
                break
            if flags >= CONTROL:
                if count:
                    self._exchange.forward(client, records[first:offset], count, stamp_ns, with_fd=with_fd)
                    count, with_fd = 0, False
                if not self._obey(client, code, records[offset + HEADER_SIZE : end]):
                    return
                first = end
            else:
                if length > wire.MAX_DATA_LENGTH or not client.number:
                    raise WireError("frame of 64 bytes at most expected, after HELLO")
                stamp_ns += 1
                pack_into(records, offset, stamp_ns)
                count += 1
                if flags & FD:
                    with_fd = True
            offset = end
        client.partial = bytes(records[offset:]) if offset < size else b""
        if count:
            whole = records[first:offset] if first or offset < size else records
            self._exchange.forward(client, whole, count, stamp_ns, with_fd=with_fd)

    def _obey(self, client: Connection, code: int, data: bytearray) -> bool:
        """Act on a control record; False when the client is no more."""
        content = wire.control_content(data)
        if code == Control.HELLO and not client.number:
            return self._join(client, content)
        if code == Control.FILTERS and client.number:
            client.filter(content)
            self._exchange.tell(client, Control.FILTERED, {"generation": content.get("generation")})
            return True
        if code == Control.QUERY:
            self._exchange.tell(client, Control.STATISTICS, self.statistics())
            return True
        if code == Control.DISTURB:
            if self._timed is None:
                raise WireError("a bus without a bit rate has no errors on the wire")
            self._timed.disturb(content)
            self._exchange.tell(client, Control.DISTURBED, {})
            return True
        if code == Control.GOODBYE:
            self._remove(client, None)
            return False
        raise WireError(f"control record {code} was not expected")

    def _join(self, client: Connection, content: dict[str, Any]) -> bool:
        if content.get("protocol") != wire.PROTOCOL_VERSION:
            raise WireError(
                f"it speaks protocol {content.get('protocol')}, the hub {wire.PROTOCOL_VERSION}; "
                "both must be of the same version"
            )
        refusal = refused_bitrate(self._timing, content)
        if refusal is not None:
            self._exchange.tell(client, Control.ENDED, {"reason": refusal, "refused": True})
            self._remove(client, f"was refused: {refusal}")
            return False
        client.introduce(self._joined + 1, content)
        self._joined += 1
        wire_facts = self._exchange.admit(client)
        welcome = {"number": client.number, "pid": os.getpid(), **wire_facts}
        self._exchange.tell(client, Control.WELCOME, welcome)
        return True

    def _set_events(self, changed: Connection | None) -> None:
        """Read from a client unless it has to be held; write while it has a backlog."""
        if changed is not None and changed.sock.fileno() < 0:
            return  # it has left; what it sent may be on the wire still
        for client in self._connections.values() if changed is None else (changed,):
            events = 0 if self._exchange.held(client) else selectors.EVENT_READ
            if client.backlog:
                events |= selectors.EVENT_WRITE
            if events == client.events:
                continue
            if not client.events:
                self._selector.register(client.sock, events, client)
            elif not events:
                self._selector.unregister(client.sock)
            else:
                self._selector.modify(client.sock, events, client)
            client.events = events

    def _remove_stalled(self) -> float | None:
        """Remove who holds all others and reads nothing; returns when to look again (s from now)."""
        stalled, again_s = self._exchange.stalled(self._stall_limit_s)
        for client in stalled:
            waiting = f"while {len(client.backlog)} bytes waited for it"
            self._remove(client, f"was removed: it read nothing for {self._stall_limit_s:g} s {waiting}")
        return self._linger_left_s() if again_s is None else again_s

    def _remove(self, client: Connection, remark: str | None) -> None:
        self._connections.pop(client.sock.fileno(), None)
        if client.events:
            self._selector.unregister(client.sock)
        client.events = 0
        client.sock.close()
        self._exchange.remove(client)
        if not self._connections:
            self._empty_since_s = time.monotonic()
        if remark:
            self._removed.append((client.number, remark))
            self._say(f"client {client} {remark}; {len(self._exchange.members)} left")

    def _close(self, reason: str) -> None:
        self.claim.release()  # first, so that a new hub need not wait for this one
        members = self._exchange.members
        for client in members:
            self._exchange.tell(client, Control.ENDED, {"reason": reason})
        deadline_s = time.monotonic() + _FAREWELL_S
        while time.monotonic() < deadline_s:
            waiting = [client for client in members if client.backlog and not client.deaf]
            if not waiting:
                break
            for client in waiting:
                client.flush()
            time.sleep(0.005)
        for client in self._connections.values():
            client.sock.close()
        self._connections.clear()
        self._selector.close()
        self._wake_read.close()
        self.wake_write.close()

    def _say(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            print(f"hub of channel '{self.channel}': {text}", file=sys.stderr, flush=True)
