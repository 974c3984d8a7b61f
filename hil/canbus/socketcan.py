"""SocketCAN as a transport needs it: no `can.Message`, nothing lost in silence, bus-off told and survived.

python-can's SocketcanBus takes three system calls a frame, has a receive buffer of 278 frames and no way to
learn that it overflowed, stamps in floats with steps of 238 ns, and always calls the bus active (4.6.1).
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import struct
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from hil.canbus.error_frames import (
    ErrorFrame,
    State,
    decode_error_frame,
    error_counters,
    state_after,
)
from hil.canbus.errors import BusLost, TransmitQueueFull
from hil.canbus.frame import EXTENDED_ID_FLAG, Frame
from hil.canbus.periodic import BroadcastTask, lease_of
from hil.canbus.socketcan_reader import FRAMES_AT_ONCE, Received, SocketReader
from hil.canbus.socketcan_socket import is_off, open_socket, options_from
from hil.canbus.socketcan_wire import (
    ERROR_FLAG,
    FILTERS_AT_MOST,
    REMOTE_FLAG,
    STANDARD_MASK,
    pack_frame,
)

__all__ = ["SocketCanPort"]

_SO_MEMINFO = 55  # asm-generic/socket.h
_MEMINFO = struct.Struct("=9I")  # linux/sock_diag.h: SK_MEMINFO_…, drops last
_RETRY_S = 0.0005
_READS_AT_MOST = 2000  # so that a drain ends even when others send without a pause
_NOT_DATA = ERROR_FLAG | REMOTE_FLAG


class SocketCanPort:
    """One CAN_RAW socket. `wanted` are the identifiers to receive, filtered by the kernel (None: all).

    Bus-off: frames are discarded, not queued, so that no stale command goes out after the restart (`not_sent`
    counts them); receivers see silence and react to that. When the controller has not restarted within
    `bus_off_limit` s, reading raises BusLost.

    Raises BusUnavailable when the interface has no CAN FD and that is asked for, BusOptionsError for a wrong
    option, OSError when the socket cannot be opened.
    """

    def __init__(
        self, channel: str, wanted: frozenset[int] | None, *, fd: bool = False, extra: Mapping[str, Any]
    ) -> None:
        self.channel = channel
        self.error_frames = 0
        self.not_sent = 0
        self.bus_state = State.ACTIVE
        self.error_counters: tuple[int, int] | None = None
        self._name = f"socketcan channel '{channel}'"
        self._fd = fd
        self._last_error: tuple[int, bytes] | None = None
        self._bus_off_since_ns: int | None = None
        self._dropped = 0
        self._ended: OSError | None = None
        self._tasks: list[BroadcastTask] = []
        self._wanted = wanted if wanted is not None and len(wanted) > FILTERS_AT_MOST else None
        options = options_from(self._name, extra)
        self._bus_off_limit_ns = round(options.bus_off_limit_s * 1e9)
        self._bit_rate_switch = options.bit_rate_switch
        self._socket, self.receive_buffer_bytes = open_socket(channel, wanted, fd=fd, options=options)
        self._hears_itself = options.receive_own_messages
        self._own_periodic: set[int] = set()
        if is_off(channel):
            self.bus_state, self._bus_off_since_ns = State.BUS_OFF, time.monotonic_ns()
        self._reader = SocketReader(self._socket.fileno())
        self._poll_in, self._poll_out = select.poll(), select.poll()
        self._poll_in.register(self._socket, select.POLLIN)
        self._poll_out.register(self._socket, select.POLLOUT)

    # -- sending -------------------------------------------------------------------------------------------

    def send_raw(self, can_id: int, data: bytes | bytearray, timeout: float | None) -> None:
        """Send a data frame; waits up to `timeout` s (None: for ever) for room in the transmit queue."""
        self._check_length(data)
        self._send(pack_frame(can_id, data, bit_rate_switch=self._bit_rate_switch), timeout)

    def send_raw_all(self, frames: Iterable[tuple[int, bytes | bytearray]], timeout: float | None) -> None:
        """Send data frames in this order."""
        for can_id, data in frames:
            self.send_raw(can_id, data, timeout)

    def send_periodic(
        self, can_id: int, data: bytes | Sequence[bytes], period_s: float, lease_s: float | None
    ) -> BroadcastTask:
        """A task of the kernel's broadcast manager; it ends with this port."""
        period_ns, frames = lease_of(period_s, lease_s)
        for part in [data] if isinstance(data, bytes | bytearray) else data:
            self._check_length(part)
        try:
            task = BroadcastTask(
                self.channel, can_id, data, period_ns, frames, bit_rate_switch=self._bit_rate_switch
            )
        except OSError as error:
            raise BusLost(
                f"{self._name}: the kernel sends no periodic messages ({error.strerror or error});"
                " load the module: modprobe can-bcm"
            ) from None
        self._tasks.append(task)
        if not self._hears_itself:
            # The broadcast manager sends from a socket of its own: here these frames are not "own" ones.
            self._own_periodic.add(_canonical(can_id))
        return task

    # -- receiving -----------------------------------------------------------------------------------------

    def drain_raw(self) -> list[Frame]:
        """All data frames that wait, without blocking."""
        frames: list[Frame] = []
        for _ in range(_READS_AT_MOST):
            read = self._read(FRAMES_AT_ONCE, pending=bool(frames))
            frames += self._data_frames(read)
            if len(read) < FRAMES_AT_ONCE:
                break
        return frames

    def recv_raw(self, timeout: float | None) -> Frame | None:
        """The next data frame, or None after `timeout` s (None: never)."""
        deadline_s = None if timeout is None else time.monotonic() + timeout
        while True:
            read = self._read(1)
            frames = self._data_frames(read)
            if frames:
                return frames[0]
            if read:
                continue  # an error frame: others may wait behind it
            left_s = None if deadline_s is None else deadline_s - time.monotonic()
            if left_s is not None and left_s <= 0:
                return None
            if self._bus_off_since_ns is not None:
                limit_s = self._bus_off_limit_ns * 1e-9
                left_s = limit_s if left_s is None else min(left_s, limit_s)
            # Rounded up, so that it does not spin for the last millisecond.
            self._poll_in.poll(None if left_s is None else int(left_s * 1000) + 1)

    @property
    def dropped(self) -> int:
        """Frames that this socket lost because its receive buffer was full, exactly and up to now."""
        if self._socket.fileno() >= 0:
            with contextlib.suppress(OSError):
                answer = self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
                self._dropped = max(self._dropped, _MEMINFO.unpack(answer)[-1])
        return self._dropped

    @property
    def last_error(self) -> ErrorFrame | None:
        """The last error frame, decoded."""
        return None if self._last_error is None else decode_error_frame(*self._last_error)

    def shutdown(self) -> None:
        """Close the socket, and end the kernel's periodic messages."""
        self._dropped = self.dropped
        for task in self._tasks:
            task.stop()
        self._socket.close()

    # -- inside --------------------------------------------------------------------------------------------

    def _check_length(self, data: bytes | bytearray) -> None:
        if len(data) > (64 if self._fd else 8):
            raise ValueError(f"{self._name}: {len(data)} data bytes; 8 fit, 64 with CAN FD (option fd)")

    def _send(self, frame: bytes, timeout: float | None) -> None:
        if self.bus_state is State.BUS_OFF:
            self.not_sent += 1
            return
        deadline_s = None
        while True:
            try:
                self._socket.send(frame)
                return
            except OSError as error:
                full = error
            if full.errno not in (errno.ENOBUFS, errno.EAGAIN):
                raise self._lost(full) from None
            now_s = time.monotonic()
            if timeout is not None:
                deadline_s = now_s + timeout if deadline_s is None else deadline_s
                if now_s >= deadline_s:
                    raise self._queue_full(timeout) from None
            if full.errno == errno.EAGAIN:  # the socket's own buffer: the kernel tells when there is room
                self._poll_out.poll(1 if timeout is None else max(1, int(timeout * 1000)))
            else:
                time.sleep(_RETRY_S)

    def _queue_full(self, timeout: float) -> TransmitQueueFull:
        return TransmitQueueFull(
            f"{self._name}: the transmit queue has been full for {timeout * 1000:g} ms ({self.bus_state}): if"
            " no other node acknowledges, start one, check wires and bit rate; for bursts lengthen the queue:"
            f" ip link set {self.channel} txqueuelen 100"
        )

    def _read(self, at_most: int, *, pending: bool = False) -> list[Received]:
        """What waits, at most so many; `pending`: the caller has frames, so an error is kept for later."""
        self._check_bus_off()
        read: list[Received] = []
        try:
            read = self._reader.read(at_most)
        except OSError as error:
            # The kernel says it once, and before the frames that still wait.
            self._ended = error
            with contextlib.suppress(OSError):
                read = self._reader.read(at_most)
        if self._ended is not None and not read and not pending:
            raise self._lost(self._ended)
        return read

    def _data_frames(self, read: list[Received]) -> list[Frame]:
        frames: list[Frame] = []
        wanted, own = self._wanted, self._own_periodic
        for stamp_ns, dropped, can_id, data in read:
            if dropped:
                self._dropped = dropped
            if can_id & _NOT_DATA:
                if can_id & ERROR_FLAG:
                    self._note_error(can_id, data)
            elif (wanted is None or can_id in wanted) and can_id not in own:
                frames.append(Frame(stamp_ns, can_id, data))
        return frames

    def _note_error(self, can_id: int, data: bytes) -> None:
        self.error_frames += 1
        data = data.ljust(8, b"\0")
        self._last_error = (can_id, data)
        self.error_counters = error_counters(can_id, data) or self.error_counters
        state = state_after(can_id, data)
        if state is None:
            return
        if state is not State.BUS_OFF:
            self._bus_off_since_ns = None
        elif self.bus_state is not State.BUS_OFF:
            self._bus_off_since_ns = time.monotonic_ns()
        self.bus_state = state

    def _check_bus_off(self) -> None:
        since = self._bus_off_since_ns
        if since is None or time.monotonic_ns() - since < self._bus_off_limit_ns:
            return
        name = self.channel
        raise BusLost(
            f"{self._name}: bus-off, and not restarted within {self._bus_off_limit_ns * 1e-9:g} s; check"
            f" wires, termination and bit rate, then: ip link set {name} type can restart; to have it restart"
            f" by itself: ip link set {name} down; ip link set {name} up type can restart-ms 100"
        )

    def _lost(self, error: OSError) -> BusLost:
        text, name = error.strerror or str(error), self.channel
        if error.errno == errno.ENETDOWN:
            return BusLost(f"{self._name}: the interface is down; ip link set {name} up")
        if error.errno in (errno.ENODEV, errno.ENXIO):
            return BusLost(f"{self._name}: the interface is gone; plug the adapter in, ip link set {name} up")
        return BusLost(f"{self._name}: {text}")


def _canonical(can_id: int) -> int:
    return can_id | EXTENDED_ID_FLAG if can_id > STANDARD_MASK else can_id
