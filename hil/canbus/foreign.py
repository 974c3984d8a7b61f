"""Any python-can bus but our own, as a transport needs it: data frames, exact identifiers, none left over."""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections import deque
from collections.abc import Iterable

import can

from hil.canbus.frame import EXTENDED_ID_FLAG, Frame

_STANDARD_MASK = 0x7FF
_EXTENDED_MASK = 0x1FFF_FFFF
_CLASSIC_LENGTH = 8
_FD_LENGTH = 64
_RECEIVE_BUFFER_BYTES = 4 << 20
_SO_RCVBUFFORCE = 33  # asm-generic/socket.h; beyond net.core.rmem_max, for CAP_NET_ADMIN
_ECHOES_REMEMBERED = 4096
_DRAIN_LIMIT = 100_000  # so that a drain ends even when others send without a pause
_EMPTY_LOOKS = 3


class ForeignPort:
    """A python-can bus behind the methods of `HilBus`'s fast path. Errors are python-can's.

    `wanted` are the identifiers to keep (None: all). `hears_itself`: the interface delivers own frames (as
    python-can's udp_multicast does); they are recognised by what they carry, in the order they were sent.
    """

    def __init__(
        self,
        bus: can.BusABC,
        wanted: frozenset[int] | None,
        *,
        fd: bool = False,
        hears_itself: bool = False,
    ) -> None:
        self._bus = bus
        self._wanted = wanted
        self._fd = fd
        self._hears_itself = hears_itself
        self._echoes: deque[tuple[int, bytes]] = deque(maxlen=_ECHOES_REMEMBERED)
        self._file = _file_number(bus)
        self.error_frames = 0
        self.dropped = 0
        if self._file >= 0:
            _enlarge_receive_buffer(self._file)

    def send_raw(self, can_id: int, data: bytes | bytearray, timeout: float | None) -> None:
        """Send a data frame; more than 8 bytes make it a CAN FD frame, ValueError where there are none."""
        if len(data) > (_FD_LENGTH if self._fd else _CLASSIC_LENGTH):
            raise ValueError(f"{self._bus}: {len(data)} data bytes; 8 fit, 64 with CAN FD (option fd)")
        message = can.Message(
            arbitration_id=can_id & _EXTENDED_MASK,
            is_extended_id=can_id > _STANDARD_MASK,
            is_fd=len(data) > _CLASSIC_LENGTH,
            data=bytes(data),
        )
        try:
            self._bus.send(message, timeout)
        except can.CanError:  # a CanTimeoutError is an OSError, too
            raise
        except OSError as error:
            raise can.CanOperationError(error.strerror or str(error), error.errno) from None
        if self._hears_itself:
            self._echoes.append((_frame_id(message), bytes(data)))

    def send_raw_all(self, frames: Iterable[tuple[int, bytes | bytearray]], timeout: float | None) -> None:
        """Send data frames in this order, one by one."""
        for can_id, data in frames:
            self.send_raw(can_id, data, timeout)

    def drain_raw(self) -> list[Frame]:
        """All data frames that wait, without blocking."""
        frames: list[Frame] = []
        empty = 0
        for _ in range(_DRAIN_LIMIT):
            message = self._receive(0.0)
            if message is None:
                # Some interfaces answer "nothing" for a frame they left out, though others wait behind it.
                empty += 1
                if empty >= _EMPTY_LOOKS or not self._waits():
                    break
                continue
            empty = 0
            frame = self._frame(message)
            if frame is not None:
                frames.append(frame)
        return frames

    def recv_raw(self, timeout: float | None) -> Frame | None:
        """The next data frame, or None after `timeout` s (None: never)."""
        deadline_s = None if timeout is None else time.monotonic() + timeout
        while True:
            message = self._receive(timeout)
            frame = None if message is None else self._frame(message)
            if frame is not None:
                return frame
            if deadline_s is not None:
                timeout = max(0.0, deadline_s - time.monotonic())
                if message is None and timeout <= 0:
                    return None

    def shutdown(self) -> None:
        """Close the bus."""
        self._bus.shutdown()

    def _receive(self, timeout: float | None) -> can.Message | None:
        try:
            return self._bus.recv(timeout)
        except can.CanError:
            raise
        except OSError as error:
            raise can.CanOperationError(error.strerror or str(error), error.errno) from None

    def _waits(self) -> bool:
        if self._file < 0:
            return False
        try:
            return bool(select.select([self._file], [], [], 0)[0])
        except (OSError, ValueError):
            return False

    def _frame(self, message: can.Message) -> Frame | None:
        """The message as a frame, or None when it is not for this node."""
        if message.is_error_frame:
            self.error_frames += 1
            return None
        if message.is_remote_frame:
            return None
        can_id = _frame_id(message)
        data = bytes(message.data)
        if self._hears_itself and self._is_echo(can_id, data):
            return None
        if self._wanted is not None and can_id not in self._wanted:
            return None
        return Frame(round(message.timestamp * 1e9), can_id, data)

    def _is_echo(self, can_id: int, data: bytes) -> bool:
        try:
            position = self._echoes.index((can_id, data))
        except ValueError:
            return False
        # Echoes come in order: those before it were lost, because the receive buffer was full.
        self.dropped += position
        for _ in range(position + 1):
            self._echoes.popleft()
        return True


def _frame_id(message: can.Message) -> int:
    return message.arbitration_id | EXTENDED_ID_FLAG if message.is_extended_id else message.arbitration_id


def _file_number(bus: can.BusABC) -> int:
    try:
        return bus.fileno()
    except NotImplementedError:
        return -1


def _enlarge_receive_buffer(number: int) -> None:
    # The default holds a few hundred frames and loses the next one in silence.
    with contextlib.suppress(OSError), socket.fromfd(number, socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER_BYTES)
