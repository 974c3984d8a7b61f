"""Messages that go out every period without being computed: sent by the kernel on SocketCAN, else by a loop.

A kernel that sends on behalf of a process would go on when the process hangs: receivers would take a dead
node for a live one. So a task has a lease: it falls silent unless its owner keeps it alive. What carries a
counter, a CRC or a computed value is not for such a task: it belongs into the owner's cycle.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from hil.canbus.errors import BusLost
from hil.canbus.socketcan_wire import pack_frame

__all__ = ["BroadcastTask", "LoopTask", "PeriodicTask", "lease_of"]

FRAMES_OF_A_LEASE = 3

# linux/can/bcm.h
_TX_SETUP, _TX_EXPIRED = 1, 9
_SET_TIMER, _START_TIMER, _COUNT_EVENT, _FD_FRAME = 0x0001, 0x0002, 0x0004, 0x0800
_HEAD = struct.Struct("@IIIllllII")
_HEAD_SIZE = -(-_HEAD.size // 8) * 8  # the frames that follow are aligned to 8 bytes
_FRAMES_AT_MOST = 256  # MAX_NFRAMES of net/can/bcm.c
_OPCODE = struct.Struct("=I")


class PeriodicTask(Protocol):
    """A message that is sent every period, as long as its owner calls `keep_alive` often enough."""

    def keep_alive(self, now_ns: int | None = None) -> None:
        """Say that the owner lives: at least once a period. `now_ns`: monotonic, default: now."""

    def update(self, data: bytes | Sequence[bytes]) -> None:
        """Other data from the next frame on, without a break in the period; as many frames as before."""

    def stop(self) -> None:
        """Send no more. May be called several times."""


def lease_of(period_s: float, lease_s: float | None) -> tuple[int, int]:
    """Period [ns] and how many frames go out without a `keep_alive`; ValueError for a length that is none."""
    for name, value in (("period_s", period_s), ("lease_s", lease_s)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} {value} must be a number of seconds above 0")
    if period_s < 1e-6:
        raise ValueError(f"period_s {period_s}: the shortest is 1e-6")
    frames = FRAMES_OF_A_LEASE if lease_s is None else max(1, math.ceil(lease_s / period_s - 1e-9))
    return round(period_s * 1e9), frames


def sequence(data: bytes | Sequence[bytes]) -> list[bytes]:
    """The data of the frames that a task sends in turn."""
    frames = [bytes(data)] if isinstance(data, bytes | bytearray) else [bytes(part) for part in data]
    if not 0 < len(frames) <= _FRAMES_AT_MOST:
        raise ValueError(f"{len(frames)} frames in turn: a task has 1 to {_FRAMES_AT_MOST}")
    return frames


class LoopTask:
    """Sent by `keep_alive` itself when it is due: for buses whose interface has no timer of its own.

    Periods that nobody kept alive are left out, not made up for.
    """

    def __init__(
        self, send: Callable[[int, bytes], None], can_id: int, data: bytes | Sequence[bytes], period_ns: int
    ) -> None:
        self._send = send
        self._can_id = can_id
        self._data = sequence(data)
        self._period_ns = period_ns
        self._next = 0
        self._due_ns: int | None = None
        self._stopped = False

    def keep_alive(self, now_ns: int | None = None) -> None:
        """Send if a period has passed since the frame before; raises what `Transport.send` raises."""
        now = time.monotonic_ns() if now_ns is None else now_ns
        if self._stopped or (self._due_ns is not None and now < self._due_ns):
            return
        due = now if self._due_ns is None else self._due_ns
        self._due_ns = due + ((now - due) // self._period_ns + 1) * self._period_ns
        self._send(self._can_id, self._data[self._next])
        self._next = (self._next + 1) % len(self._data)

    def update(self, data: bytes | Sequence[bytes]) -> None:
        """Other data from the next frame on."""
        frames = sequence(data)
        if len(frames) != len(self._data):
            raise ValueError(f"{len(frames)} frames in turn: this task has {len(self._data)}")
        self._data = frames

    def stop(self) -> None:
        """Send no more."""
        self._stopped = True


class BroadcastTask:
    """Sent by the kernel's broadcast manager (CAN_BCM, Documentation/networking/can.rst), timed by it.

    The kernel counts the lease down frame by frame. `keep_alive` renews it when half of it has passed, which
    leaves the phase as it is; a lease that ran out is noticed and started anew. The task ends with its
    socket, so with the process, however that ends. Its frames count nowhere as sent.
    """

    def __init__(
        self,
        channel: str,
        can_id: int,
        data: bytes | Sequence[bytes],
        period_ns: int,
        lease_frames: int,
        *,
        bit_rate_switch: bool = False,
    ) -> None:
        self._channel = channel
        self._can_id = can_id
        self._bit_rate_switch = bit_rate_switch
        self._period_us = max(1, round(period_ns / 1000))
        self._lease_frames = lease_frames
        self._renew_after_ns = lease_frames * period_ns // 2
        self._frames = sequence(data)
        self._renewed_ns = time.monotonic_ns()
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_BCM)
        try:
            self._socket.setblocking(False)
            self._socket.connect((channel,))
            self._set_up(_START_TIMER)
        except BaseException:
            self._socket.close()
            raise

    def keep_alive(self, now_ns: int | None = None) -> None:
        """Renew the lease if half of it has passed. Raises BusLost when the interface has gone."""
        now = time.monotonic_ns() if now_ns is None else now_ns
        if now - self._renewed_ns < self._renew_after_ns or self._socket.fileno() < 0:
            return
        self._renewed_ns = now
        self._guarded(_START_TIMER if self._has_expired() else 0)

    def update(self, data: bytes | Sequence[bytes]) -> None:
        """Other data from the next frame on; the phase stays, and so does the place in a sequence."""
        frames = sequence(data)
        if len(frames) != len(self._frames):
            raise ValueError(f"{len(frames)} frames in turn: this task has {len(self._frames)}")
        self._frames = frames
        if self._socket.fileno() >= 0:
            self._renewed_ns = time.monotonic_ns()
            self._guarded(_START_TIMER if self._has_expired() else 0)

    def stop(self) -> None:
        """Send no more."""
        self._socket.close()

    def _guarded(self, flags: int) -> None:
        try:
            self._set_up(flags)
        except OSError as error:
            raise BusLost(f"socketcan channel '{self._channel}': {error.strerror or error}") from None

    def _set_up(self, flags: int) -> None:
        frames = [
            pack_frame(self._can_id, data, bit_rate_switch=self._bit_rate_switch) for data in self._frames
        ]
        size = max(map(len, frames))
        if size > 16:
            flags |= _FD_FRAME
        seconds, microseconds = divmod(self._period_us, 1_000_000)
        head = _HEAD.pack(
            _TX_SETUP, flags | _SET_TIMER | _COUNT_EVENT, self._lease_frames, seconds, microseconds, 0, 0,
            int.from_bytes(frames[0][:4], "little" if struct.pack("=H", 1)[0] else "big"), len(frames),
        )  # fmt: skip
        content = b"".join(frame.ljust(size, b"\0") for frame in frames)
        self._socket.send(head.ljust(_HEAD_SIZE, b"\0") + content)

    def _has_expired(self) -> bool:
        """Whether the kernel has said (TX_EXPIRED) that the lease ran out; takes all that it said."""
        expired = False
        with contextlib.suppress(BlockingIOError):
            while True:
                answer = self._socket.recv(4096)
                expired |= len(answer) >= 4 and _OPCODE.unpack_from(answer)[0] == _TX_EXPIRED
        return expired
