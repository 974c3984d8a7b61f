"""Local bus, the client's end of the connection: records out, records in, and why it ended.

Any thread may send, any thread may receive; in the fast path there is no thread but the caller's.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from typing import Any

import can

from hil.canbus.error_frames import ErrorFrame, decode_error_frame, error_counters, state_after
from hil.canbus.frame import Frame
from hil.canbus.local import address, link, wire
from hil.canbus.local.confinement import State
from hil.canbus.local.credit import TransmitCredit, count_frames
from hil.canbus.local.filters import Filter
from hil.canbus.local.polling import Polling
from hil.canbus.local.wire import CONTROL, ERROR, HEADER, HEADER_SIZE, REMOTE, Control

Record = tuple[int, int, bytes, int, int]
"""Time stamp (ns), identifier with SocketCAN's flag bits, data, flags, dlc."""

NOT_DATA = REMOTE | ERROR

_CHUNK_BYTES = 64 << 10
_AHEAD_BYTES = 256 << 10
"""So much a sender reads ahead to learn what was sent: 10,000 classic frames that wait for their reader."""
_CHUNKS_A_DRAIN = 64  # so that a drain ends even when others send without a pause
_FILTER_LIMIT_S = 5.0
_QUERY_LIMIT_S = 0.2


class HubLostError(can.CanOperationError):
    """The hub has ended, or has removed this client."""


class TransmitQueueFullError(can.CanOperationError):
    """The hub takes no frame now, because somebody reads too slowly; this frame was not sent."""


class Stream:
    """A joined connection. Raises what `link.join` raises."""

    def __init__(self, channel: str, hello: dict[str, Any], *, autostart: bool) -> None:
        self.channel = channel
        self.error_frames = 0
        """Error frames left out of what `drain` returned."""
        self.bus_state = State.ACTIVE
        self.error_counters: tuple[int, int] | None = None
        self.last_error: ErrorFrame | None = None
        self._sock, welcome = link.join(channel, hello, autostart=autostart)
        self._number, self._hub_pid = welcome["number"], welcome["pid"]
        self.bitrate: int | None = welcome.get("bitrate")
        self.credit = TransmitCredit(welcome.get("tx_queue"))
        self._ended: str | None = None
        self._farewell: str | None = None
        self._buffer = b""
        self._at = 0  # how much of the buffer has been taken
        self._receive_lock = threading.RLock()
        self._send_lock = threading.Lock()
        self._generation = self._applied = 0  # of the filters
        self._watched = False
        self._polling = Polling()
        self._quiet_end: socket.socket | None = None

    def note_error(self, can_id: int, data: bytes) -> None:
        """Count an error frame, and keep what it says of this client's own error confinement."""
        data = data.ljust(8, b"\0")
        self.error_frames += 1
        self.bus_state = state_after(can_id, data) or self.bus_state
        self.error_counters = error_counters(can_id, data) or self.error_counters
        self.last_error = decode_error_frame(can_id, data)

    def fileno(self) -> int:
        """The socket's file number; -1 when closed."""
        self._watched = True
        return self._sock.fileno()

    def close(self) -> None:
        """Say goodbye and close. May be called several times."""
        if self._ended is None:
            self._ended = f"hil channel '{self.channel}' was shut down here"
            with contextlib.suppress(OSError):  # without a goodbye the hub sees the end of the connection
                self._sock.settimeout(1.0)
                self._sock.sendall(wire.control_record(Control.GOODBYE, {}))
                self._sock.shutdown(socket.SHUT_RDWR)  # wakes a thread that waits for a frame
        self._sock.close()
        if self._quiet_end is not None:
            self._quiet_end.close()

    # -- out -----------------------------------------------------------------------------------------------

    def send(self, record: bytes, timeout_s: float | None) -> None:
        """Send a record; waits up to `timeout_s` (None: for ever) while the queue is full.

        Raises TransmitQueueFullError, HubLostError.
        """
        if self.bitrate is not None:
            timeout_s = self._await_credit(record, timeout_s)
        if self._send_now(record):
            return
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            remaining_s = None if deadline_s is None else deadline_s - time.monotonic()
            if remaining_s is not None and remaining_s <= 0:
                self.credit.hand(-count_frames(record) if self.bitrate is not None else 0)
                raise TransmitQueueFullError(self._why_full(timeout_s or 0.0))
            # The kernel calls a socket writable late, when most of it is free: look in between.
            wire.wait_writable(self._sock, 0.05 if remaining_s is None else min(remaining_s, 0.05))
            if self._send_now(record):
                return

    def _await_credit(self, record: bytes, timeout_s: float | None) -> float | None:
        """With a bit rate: wait until the transmit queue has room; returns what is left of `timeout_s`."""
        frames = count_frames(record)
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        # Who watches the file number has to find what arrives there, and who never reads shall not hoard it:
        # then only the hub holds this sender.
        while frames and not self._watched and not self.credit.allows(frames):
            if len(self._buffer) - self._at >= _AHEAD_BYTES:
                break
            with self._receive_lock:
                pulled = self._pull(read_ahead=True)
                if pulled:
                    self._look_ahead()
            if pulled:
                continue
            remaining_s = None if deadline_s is None else deadline_s - time.monotonic()
            if remaining_s is not None and remaining_s <= 0:
                raise TransmitQueueFullError(self._why_full(timeout_s or 0.0))
            wire.wait_readable(self._sock, 0.05 if remaining_s is None else min(remaining_s, 0.05))
        self.credit.hand(frames)
        return None if deadline_s is None else max(0.0, deadline_s - time.monotonic())

    def _send_now(self, record: bytes) -> bool:
        """Send the whole record or nothing."""
        if self._ended is not None:
            raise HubLostError(self._ended)
        with self._send_lock:
            try:
                sent = self._sock.send(record)
                while sent < len(record):  # TCP or a long control record; AF_UNIX takes a frame whole
                    wire.wait_writable(self._sock, None)
                    with contextlib.suppress(BlockingIOError):
                        sent += self._sock.send(record[sent:])
            except BlockingIOError:
                return False
            except OSError:
                raise self._lost() from None
        return True

    def _why_full(self, waited_s: float) -> str:
        waited = f"took no frame for {waited_s:g} s" if waited_s else "takes no frame now"
        text = f"transmit queue full: hil channel '{self.channel}' {waited}"
        try:
            clients = link.query(self.channel, _QUERY_LIMIT_S)["clients"]
        except (OSError, wire.WireError):
            return f"{text}; its hub does not answer"
        if self.credit.pending:
            text += f"; {self.credit.pending} frames wait for the wire ({self.bitrate} bit/s)"
            if len(clients) < 2:
                text += "; nobody else is there to acknowledge them"
        slow = [f"'{client['name']}' (process {client['pid']})" for client in clients if client["stalled"]]
        return f"{text}; too slow in reading: {', '.join(slow)}" if slow else text

    # -- in ------------------------------------------------------------------------------------------------

    def receive(self, timeout_s: float | None, *, read_ahead: bool) -> Record | None:
        """The next frame; waits up to `timeout_s` (None: for ever). Raises HubLostError.

        Without `read_ahead` one record is read at a time: what is not returned stays in the socket, which
        then stays readable for those who watch `fileno`.
        """
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        polling = self._polling
        if polling.limit_ns and timeout_s != 0 and self._at >= len(self._buffer):
            polling.wait_readable(self._sock, timeout_s)  # does not begin with a look in vain
        while True:
            with self._receive_lock:
                record = self._take() if self._buffer else None
                while record is None and self._pull(read_ahead=read_ahead):
                    record = self._take()
            if record is not None:
                return record
            remaining_s = None if deadline_s is None else deadline_s - time.monotonic()
            if remaining_s is not None and remaining_s <= 0:
                return None
            polling.wait_readable(self._sock, remaining_s)

    def drain(self) -> list[Frame]:
        """All data frames that wait, without blocking. Raises HubLostError when there are none any more."""
        frames: list[Frame] = []
        with self._receive_lock:
            self._parse(frames)
            for _ in range(_CHUNKS_A_DRAIN):
                try:
                    pulled = self._pull(read_ahead=True)
                except HubLostError:
                    if frames:
                        break  # the next call says so
                    raise
                self._parse(frames)
                if pulled < _CHUNK_BYTES:
                    break
            if self._farewell is not None and not frames:
                raise self._lost()
        return frames

    def push_filters(self, filters: list[Filter] | None) -> None:
        """Let the hub filter from here on; what it has sent before stays queued. Raises CanOperationError."""
        self._generation += 1
        generation = self._generation
        record = wire.control_record(Control.FILTERS, {"generation": generation, "filters": filters})
        self.send(record, _FILTER_LIMIT_S)
        deadline_s = time.monotonic() + _FILTER_LIMIT_S
        while self._applied < generation:  # another thread may meet the hub's answer, too
            with self._receive_lock:
                pulled = self._pull(read_ahead=True)
                if pulled < _CHUNK_BYTES:
                    self._look_ahead()
            if not pulled and self._applied < generation:
                if time.monotonic() > deadline_s:
                    raise can.CanOperationError(
                        f"hil channel '{self.channel}': its hub took no filters for {_FILTER_LIMIT_S:g} s"
                    )
                wire.wait_readable(self._sock, 0.05)

    # -- in, with the lock held ----------------------------------------------------------------------------

    def _pull(self, *, read_ahead: bool) -> int:
        """Read from the socket into the buffer, without blocking; the number of bytes, 0 when none wait."""
        if self._ended is not None:
            self._quieten()
            raise HubLostError(self._ended)
        rest = self._buffer[self._at :] if self._at < len(self._buffer) else b""
        if read_ahead:
            wanted = _CHUNK_BYTES
        elif len(rest) < HEADER_SIZE:
            wanted = HEADER_SIZE - len(rest)
        else:
            wanted = HEADER_SIZE + HEADER.unpack_from(rest)[2] - len(rest)
        try:
            chunk = self._sock.recv(wanted)
        except BlockingIOError:
            return 0
        except OSError:
            chunk = b""
        if not chunk:
            lost = self._lost()
            self._quieten()
            raise lost
        self._buffer = rest + chunk if rest else chunk
        self._at = 0
        return len(chunk)

    def _take(self) -> Record | None:
        """The next frame of the buffer."""
        while True:
            start = self._at + HEADER_SIZE
            if start > len(self._buffer):
                return None
            stamp_ns, can_id, length, flags, dlc = HEADER.unpack_from(self._buffer, self._at)
            end = start + length
            if end > len(self._buffer):
                return None
            self._at = end
            data = self._buffer[start:end]
            if flags < CONTROL:
                return stamp_ns, can_id, data, flags, dlc
            self._obey(can_id, data)

    def _parse(self, frames: list[Frame]) -> None:
        """Append all data frames of the buffer."""
        buffer, offset = self._buffer, self._at
        size = len(buffer)
        unpack_from, append = HEADER.unpack_from, frames.append
        make = tuple.__new__  # half the time of Frame(...), which the cycle of a node pays for each frame
        start = offset + HEADER_SIZE
        while start <= size:
            stamp_ns, can_id, length, flags, _ = unpack_from(buffer, offset)
            end = start + length
            if end > size:
                break
            if flags >= CONTROL:
                self._obey(can_id, buffer[start:end])
            elif not can_id & NOT_DATA:
                append(make(Frame, (stamp_ns, can_id, buffer[start:end])))
            elif can_id & ERROR:
                self.note_error(can_id, buffer[start:end])
            offset, start = end, end + HEADER_SIZE
        self._at = offset

    def _look_ahead(self) -> None:
        """Act on control records in the buffer; the frames before them stay."""
        offset, size = self._at, len(self._buffer)
        while offset + HEADER_SIZE <= size:
            _, code, length, flags, _ = HEADER.unpack_from(self._buffer, offset)
            start, offset = offset + HEADER_SIZE, offset + HEADER_SIZE + length
            if flags >= CONTROL and offset <= size:
                self._obey(code, self._buffer[start:offset])

    def _obey(self, code: int, data: bytes) -> None:
        if code == Control.SENT:
            self.credit.note(data)
            return
        content = wire.control_content(data)
        if code == Control.FILTERED:
            self._applied = max(self._applied, int(content["generation"]))
        elif code == Control.ENDED:
            self._farewell = f"the hub of channel '{self.channel}' has ended ({content.get('reason')})"

    # -- the end -------------------------------------------------------------------------------------------

    def _lost(self) -> HubLostError:
        """The connection is at its end: keep what it still holds, and find out why."""
        with self._receive_lock:
            if self._ended is None:
                with contextlib.suppress(OSError):
                    while chunk := self._sock.recv(_CHUNK_BYTES):
                        self._buffer, self._at = self._buffer[self._at :] + chunk, 0
                self._look_ahead()
                self._ended = self._farewell or self._ask_why()
            return HubLostError(self._ended)

    def _ask_why(self) -> str:
        with contextlib.suppress(OSError, wire.WireError, address.AddressError):
            statistics = link.query(self.channel, _QUERY_LIMIT_S)
            if statistics["pid"] == self._hub_pid:
                for removed in statistics["removed"]:
                    if removed["number"] == self._number:
                        return f"the hub of channel '{self.channel}' says: this client {removed['reason']}"
        return f"the hub of channel '{self.channel}' has ended without a goodbye; was it killed?"

    def _quieten(self) -> None:
        """Once the end has been told, let an event loop that watches the file number rest."""
        # An asyncio Notifier would otherwise call recv() again and again: an ended socket stays readable.
        if (
            self._watched
            and self._quiet_end is None
            and address.HAVE_UNIX_SOCKETS
            and self._sock.fileno() >= 0
        ):
            silent, self._quiet_end = socket.socketpair()
            os.dup2(silent.fileno(), self._sock.fileno(), inheritable=False)
            silent.close()
