"""Local bus, the wire: records that a client and the hub exchange over their stream socket.

A record is a 16-byte little-endian header and 0..64 bytes of data (a control record: up to 65,535)::

    int64  timestamp_ns   CLOCK_REALTIME, stamped by the hub, strictly increasing; 0 towards the hub
    uint32 can_id         identifier with SocketCAN's flag bits EFF, RTR, ERR (linux/can.h)
    uint16 length         bytes of data that follow
    uint8  flags          BRS, ESI, FD as in canfd_frame.flags; OWN: the receiver's own frame; CONTROL
    uint8  dlc            data length that a remote frame asks for

In a control record `can_id` holds the `Control` code and the data is JSON (binary in SENT).
"""

from __future__ import annotations

import json
import select
import socket
import struct
from enum import IntEnum
from typing import Any

PROTOCOL_VERSION = 1

HEADER = struct.Struct("<qIHBB")
HEADER_SIZE = HEADER.size
STAMP = struct.Struct("<q")
FLAGS_OFFSET = 14
MAX_DATA_LENGTH = 64
MAX_CONTROL_LENGTH = 0xFFFF

EXTENDED = 0x8000_0000
REMOTE = 0x4000_0000
ERROR = 0x2000_0000
EXTENDED_MASK = 0x1FFF_FFFF
STANDARD_MASK = 0x7FF

BRS = 0x01
ESI = 0x02
FD = 0x04
OWN = 0x10
CONTROL = 0x80

_SELECT_LIMIT = 1024  # select() takes file numbers below FD_SETSIZE only


class Control(IntEnum):
    """What a control record says."""

    HELLO = 1  # client -> hub: protocol, name, pid, receive_own, fd, bitrate, data_bitrate, filters
    WELCOME = 2  # hub -> client: client number, hub's pid, bit rate; from here on the client receives
    FILTERS = 3  # client -> hub: new filters, and a generation number
    FILTERED = 4  # hub -> client: the filters of that generation apply from here on
    GOODBYE = 5  # client -> hub: leaves on purpose
    ENDED = 6  # hub -> client: the hub ends, or removes this client; why
    QUERY = 7  # instead of HELLO: asks for statistics, does not join
    STATISTICS = 8  # hub -> asker
    SENT = 9  # hub with a bit rate -> client: how many of its frames are done (binary, see `credit.py`)
    DISTURB = 10  # instead of HELLO: make errors on the wire, of which kind
    DISTURBED = 11  # hub -> asker


class WireError(ValueError):
    """The other side sent something that is no record."""


def control_record(code: Control, content: dict[str, Any]) -> bytes:
    """A control record; raises WireError when its content is longer than 65,535 bytes."""
    data = json.dumps(content, separators=(",", ":")).encode()
    if len(data) > MAX_CONTROL_LENGTH:
        raise WireError(f"control record {code.name} is {len(data)} bytes long, limit {MAX_CONTROL_LENGTH}")
    return HEADER.pack(0, code, len(data), CONTROL, 0) + data


def control_content(data: bytes | bytearray | memoryview) -> dict[str, Any]:
    """The content of a control record's data; raises WireError when it is not a JSON object."""
    try:
        content = json.loads(bytes(data))
    except (ValueError, RecursionError) as error:
        raise WireError(f"control record is not JSON: {error}") from None
    if not isinstance(content, dict):
        raise WireError("control record is not a JSON object")
    return content


def wait_readable(sock: socket.socket, timeout_s: float | None) -> bool:
    """Wait until `sock` can be read or has ended, at most `timeout_s` (None: for ever, 0: not at all)."""
    return _wait(sock, timeout_s, write=False)


def wait_writable(sock: socket.socket, timeout_s: float | None) -> bool:
    """Wait until `sock` takes data or has ended, at most `timeout_s` (None: for ever, 0: not at all)."""
    return _wait(sock, timeout_s, write=True)


def _wait(sock: socket.socket, timeout_s: float | None, *, write: bool) -> bool:
    # select() because its timeout resolves microseconds; poll() rounds up to milliseconds.
    if timeout_s is not None and timeout_s < 0:
        timeout_s = 0.0
    number = sock.fileno()
    if number < 0:
        return True  # closed in another thread: the next call on it says so
    if number < _SELECT_LIMIT:
        ready = (
            select.select([], [number], [], timeout_s)
            if write
            else select.select([number], [], [], timeout_s)
        )
        return bool(ready[1] if write else ready[0])
    poll = select.poll()
    poll.register(number, select.POLLOUT if write else select.POLLIN)
    return bool(poll.poll(None if timeout_s is None else timeout_s * 1000))
