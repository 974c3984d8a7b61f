"""Reads a SocketCAN socket: up to 64 frames with stamp and drop counter in one system call (recvmmsg).

Python's `recvmsg` makes two system calls a frame: for AF_CAN it also asks for the interface's name each time.
"""

from __future__ import annotations

import ctypes
import errno
import os
import struct

from hil.canbus.socketcan_wire import FD_FRAME_SIZE, HEADER, SO_TIMESTAMPNS, parse_control

__all__ = ["Received", "SocketReader"]

FRAMES_AT_ONCE = 64
_CONTROL_SIZE = 64  # a time stamp and a drop counter take 56 bytes on a 64-bit machine
_MSG_DONTWAIT = 0x40
_NOTHING_THERE = {errno.EAGAIN, errno.EWOULDBLOCK, errno.EINTR}
_STAMPED = struct.Struct("@Niill")
_SOL_SOCKET = 1

Received = tuple[int, int, int, bytes]
"""Time stamp [ns since the epoch], drop counter (0: not told), identifier with flags, data."""


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _Message(ctypes.Structure):
    """struct msghdr."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint),
        ("vectors", ctypes.c_void_p),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _CountedMessage(ctypes.Structure):
    """struct mmsghdr: a message, and how many bytes came."""

    _fields_ = (("message", _Message), ("received", ctypes.c_uint))


class SocketReader:
    """The receiving side of one socket, whose buffers are made once."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._frames = bytearray(FRAMES_AT_ONCE * FD_FRAME_SIZE)
        self._control = bytearray(FRAMES_AT_ONCE * _CONTROL_SIZE)
        self._headers = (_CountedMessage * FRAMES_AT_ONCE)()
        self._vectors = (_Vector * FRAMES_AT_ONCE)()
        frames = ctypes.addressof(ctypes.c_char.from_buffer(self._frames))
        control = ctypes.addressof(ctypes.c_char.from_buffer(self._control))
        for index in range(FRAMES_AT_ONCE):
            vector, message = self._vectors[index], self._headers[index].message
            vector.base, vector.length = frames + index * FD_FRAME_SIZE, FD_FRAME_SIZE
            message.vectors, message.vector_count = ctypes.addressof(vector), 1
            message.control = control + index * _CONTROL_SIZE
            message.control_length = _CONTROL_SIZE
        # A message's structure is made once: reaching into the array makes a new object each time.
        self._messages = [header.message for header in self._headers]
        self._recvmmsg = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._recvmmsg.argtypes = [
            ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p,
        ]  # fmt: skip
        self._address = ctypes.addressof(self._headers)

    def read(self, at_most: int = FRAMES_AT_ONCE) -> list[Received]:
        """The frames that wait, oldest first, up to `at_most`; none: an empty list. Raises OSError."""
        count = self._recvmmsg(self._number, self._address, at_most, _MSG_DONTWAIT, None)
        if count < 0:
            number = ctypes.get_errno()
            if number in _NOTHING_THERE:
                return []
            raise OSError(number, os.strerror(number))
        frames, control, messages = self._frames, self._control, self._messages
        received: list[Received] = []
        for index in range(count):
            message = messages[index]
            at, control_at = index * FD_FRAME_SIZE, index * _CONTROL_SIZE
            can_id, length, _, _ = HEADER.unpack_from(frames, at)
            _, level, kind, seconds, nanoseconds = _STAMPED.unpack_from(control, control_at)
            control_length = message.control_length
            if control_length == _STAMPED.size and level == _SOL_SOCKET and kind == SO_TIMESTAMPNS:
                stamp_ns, dropped = seconds * 1_000_000_000 + nanoseconds, 0
            else:
                stamp_ns, dropped = parse_control(control[control_at : control_at + control_length])
            message.control_length = _CONTROL_SIZE  # the kernel has put there how much it used
            received.append((stamp_ns, dropped, can_id, bytes(frames[at + 8 : at + 8 + length])))
        return received
