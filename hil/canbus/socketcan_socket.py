"""Opens a SocketCAN socket with all that a transport wants: filters, receive buffer, stamps, error frames."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.canbus.errors import BusOptionsError, BusUnavailable
from hil.canbus.socketcan_wire import (
    FD_FRAME_SIZE,
    FILTERS_AT_MOST,
    SO_RXQ_OVFL,
    SO_TIMESTAMPNS,
    pack_filters,
)

__all__ = ["SocketOptions", "is_off", "open_socket", "options_from"]

RECEIVE_BUFFER_BYTES = 8 << 20
"""The kernel doubles it and counts about 770 bytes a classic frame: 5 s of a full bus at 500 kbit/s."""

BUS_OFF_LIMIT_S = 2.0
"""A controller that restarts by itself (restart-ms) is back long before; one that does not never is."""

OPTIONS = ("receive_buffer", "bus_off_limit", "bit_rate_switch")
SHARED_OPTIONS = ("receive_own_messages", "local_loopback", "ignore_rx_error_frames")
"""With the names and meanings that python-can gives them."""

IGNORED_OPTIONS = ("data_bitrate", "timing", "single_handle", "state")
"""What python-can's command line or configuration hands to every interface; `ip link` sets bit rates."""

_SO_RCVBUFFORCE = 33  # asm-generic/socket.h
_CAN_RAW_ERR_FILTER = 2  # linux/can/raw.h
_ALL_ERRORS = 0x1FFF_FFFF  # CAN_ERR_MASK


@dataclass(frozen=True)
class SocketOptions:
    """`receive_buffer` [bytes] is what the kernel is asked for; `bit_rate_switch`: of CAN FD frames."""

    receive_buffer: int = RECEIVE_BUFFER_BYTES
    bus_off_limit_s: float = BUS_OFF_LIMIT_S
    bit_rate_switch: bool = False
    receive_own_messages: bool = False
    local_loopback: bool = True
    ignore_rx_error_frames: bool = False


def options_from(name: str, extra: Mapping[str, Any]) -> SocketOptions:
    """The options among a bus's keyword arguments. Raises BusOptionsError: unknown, or no valid value."""
    unknown = sorted(extra.keys() - {*OPTIONS, *SHARED_OPTIONS, *IGNORED_OPTIONS})
    if unknown:
        known = ", ".join(OPTIONS + SHARED_OPTIONS)
        raise BusOptionsError(f"{name}: no option '{unknown[0]}'; it has {known}")
    limit = extra.get("bus_off_limit", BUS_OFF_LIMIT_S)
    size = extra.get("receive_buffer", RECEIVE_BUFFER_BYTES)
    if not isinstance(limit, int | float) or isinstance(limit, bool) or not 0 <= limit <= 1e6:
        raise BusOptionsError(f"{name}: bus_off_limit={limit} must be a number of seconds from 0 to 1e6")
    if not isinstance(size, int) or isinstance(size, bool) or not 0 < size <= 1 << 30:
        raise BusOptionsError(f"{name}: receive_buffer={size} must be a number of bytes from 1 to 2**30")
    return SocketOptions(
        receive_buffer=size,
        bus_off_limit_s=limit,
        bit_rate_switch=bool(extra.get("bit_rate_switch", False)),
        receive_own_messages=bool(extra.get("receive_own_messages", False)),
        local_loopback=bool(extra.get("local_loopback", True)),
        ignore_rx_error_frames=bool(extra.get("ignore_rx_error_frames", False)),
    )


def open_socket(
    channel: str, wanted: frozenset[int] | None, *, fd: bool, options: SocketOptions
) -> tuple[socket.socket, int]:
    """A non-blocking CAN_RAW socket on `channel`, and the receive buffer [bytes] that the kernel gave it.

    `wanted` are filtered by the kernel, up to `FILTERS_AT_MOST`. Raises BusUnavailable when CAN FD is asked
    for and the interface has none, OSError when there is no such interface.
    """
    if fd:
        _check_fd(channel)
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    try:
        raw = socket.SOL_CAN_RAW
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        sock.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        sock.setsockopt(raw, socket.CAN_RAW_RECV_OWN_MSGS, int(options.receive_own_messages))
        sock.setsockopt(raw, socket.CAN_RAW_LOOPBACK, int(options.local_loopback))
        sock.setsockopt(raw, socket.CAN_RAW_FD_FRAMES, int(fd))
        if not options.ignore_rx_error_frames:
            sock.setsockopt(raw, _CAN_RAW_ERR_FILTER, _ALL_ERRORS)
        if wanted is not None and not wanted:
            sock.setsockopt(raw, socket.CAN_RAW_FILTER, None, 0)  # nothing but error frames
        elif wanted is not None and len(wanted) <= FILTERS_AT_MOST:
            sock.setsockopt(raw, socket.CAN_RAW_FILTER, pack_filters(wanted))
        size = _enlarge_receive_buffer(sock, options.receive_buffer)
        sock.setblocking(False)
        sock.bind((channel,))  # last: it begins the reception
    except BaseException:
        sock.close()
        raise
    return sock, size


def is_off(channel: str) -> bool:
    """Whether the adapter of an interface that is up is off the bus now: its link has no carrier.

    Only an adapter of hardware: a vxcan has no carrier while its other end is down.
    """
    interface = Path(f"/sys/class/net/{channel}")
    try:
        return (interface / "device").exists() and (interface / "carrier").read_text().strip() == "0"
    except OSError:
        return False


def _check_fd(channel: str) -> None:
    try:
        mtu = int(Path(f"/sys/class/net/{channel}/mtu").read_text())
    except (OSError, ValueError):
        return
    if mtu < FD_FRAME_SIZE:
        remedy = f"ip link set {channel} up mtu 72"
        if not channel.startswith("vcan"):
            remedy = f"ip link set {channel} up type can bitrate 500000 dbitrate 2000000 fd on"
        raise BusUnavailable(
            f"socketcan channel '{channel}': set up without CAN FD; ip link set {channel} down; {remedy}"
        )


def _enlarge_receive_buffer(sock: socket.socket, size: int) -> int:
    # Beyond net.core.rmem_max for who may (CAP_NET_ADMIN), else up to it.
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, size)
    except OSError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
