"""A node's way to the bus: opens any python-can bus, sends and drains data frames, counts what is lost.

The local bus and SocketCAN have a fast path without `can.Message`; all other interfaces go through `can.Bus`.
Identifiers are filtered where it costs least: in the hub, in the kernel, else here. Never by python-can's
`can_filters` on an interface without a filter of its own: its `recv(0)` says "nothing there" at the first
frame it leaves out, though others wait behind (python-can, pull request 1686).
"""

from __future__ import annotations

import contextlib
import errno
import logging
from collections.abc import Iterable, Iterator, Sequence
from types import TracebackType
from typing import Any, Protocol

import can

from hil.canbus.error_frames import ErrorFrame, State
from hil.canbus.errors import BusError, BusLost, BusOptionsError, BusUnavailable, TransmitQueueFull
from hil.canbus.foreign import ForeignPort
from hil.canbus.frame import EXTENDED_ID_FLAG, Frame
from hil.canbus.local.address import AddressError, check_channel
from hil.canbus.local.client import IGNORED_OPTIONS, OPTIONS, HilBus, TransmitQueueFullError
from hil.canbus.local.filters import INVERT
from hil.canbus.options import (
    LOCAL_INTERFACE,
    BusOptions,
    add_bus_arguments,
    default_options,
    has_socketcan,
    is_can_interface_up,
    options_from_namespace,
)
from hil.canbus.periodic import LoopTask, PeriodicTask, lease_of
from hil.canbus.socketcan import SocketCanPort

__all__ = [
    "EXTENDED_ID_FLAG",
    "BusError",
    "BusLost",
    "BusOptions",
    "BusOptionsError",
    "BusUnavailable",
    "Frame",
    "TransmitQueueFull",
    "Transport",
    "add_bus_arguments",
    "default_options",
    "options_from_namespace",
]

SEND_TIMEOUT_S = 0.02
"""Longer than a receiver's cycle, short against the silence limits of the bus contract."""

_NO_BUFFER_SPACE = {errno.ENOBUFS, errno.EAGAIN}


class Port(Protocol):
    """What a transport needs of a bus; errors are python-can's."""

    def send_raw(self, can_id: int, data: bytes | bytearray, timeout: float | None) -> None: ...

    def send_raw_all(
        self, frames: Iterable[tuple[int, bytes | bytearray]], timeout: float | None
    ) -> None: ...

    def drain_raw(self) -> list[Frame]: ...

    def recv_raw(self, timeout: float | None) -> Frame | None: ...

    @property
    def error_frames(self) -> int: ...

    def shutdown(self) -> None: ...


class Transport:
    """A node on a bus. Opened by `Transport.open`; a context manager.

    `sent` and `received` count data frames, `dropped` those that are known to be lost, `not_sent` those that
    were discarded because the controller was bus-off, `error_frames` the error frames met. Remote frames are
    left out.
    """

    def __init__(self, port: Port, options: BusOptions, *, send_timeout_s: float = SEND_TIMEOUT_S) -> None:
        self.options = options
        self.send_timeout_s = send_timeout_s
        self.received = 0
        self._taken = 0
        self._port = port

    @classmethod
    def open(
        cls,
        options: BusOptions,
        *,
        name: str,
        receive: Iterable[int] | None = None,
        send_timeout_s: float = SEND_TIMEOUT_S,
    ) -> Transport:
        """Join a bus as `name`, to receive the identifiers `receive` (None: all; empty: nothing).

        Raises BusUnavailable when the bus cannot be opened: in one line what is missing, and the remedy;
        BusOptionsError for a wrong option.
        """
        wanted = None if receive is None else frozenset(map(_canonical, receive))
        with _translated_opening(options):
            return cls(_open_port(options, name, wanted), options, send_timeout_s=send_timeout_s)

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """Send a data frame (more than 8 bytes: CAN FD), in `send_timeout_s` at most.

        Raises TransmitQueueFull when it was not taken in that time, BusLost when the bus has ended,
        ValueError when the data are too long for the bus.
        """
        try:
            self._port.send_raw(can_id, data, self.send_timeout_s)
        except can.CanError as error:
            raise _translated(error, self.options) from None
        self._taken += 1

    def send_all(self, frames: Sequence[tuple[int, bytes | bytearray]]) -> None:
        """Send data frames in this order: what a node says in one cycle. Raises as `send`.

        On the local bus they go in one system call; elsewhere one by one.
        """
        try:
            self._port.send_raw_all(frames, self.send_timeout_s)
        except can.CanError as error:
            raise _translated(error, self.options) from None
        self._taken += len(frames)

    def send_periodic(
        self, can_id: int, data: bytes | Sequence[bytes], period_s: float, *, lease_s: float | None = None
    ) -> PeriodicTask:
        """Send a data frame, or several in turn, every `period_s` while the caller keeps the task alive.

        On SocketCAN the kernel sends, at its own time; it stops `lease_s` (default: three periods) after the
        last `keep_alive`. Elsewhere `keep_alive` sends when it is due. For data that need no computing and no
        E2E protection. Ends with this transport. Raises as `send`; ValueError for a time that is none.
        """
        if isinstance(self._port, SocketCanPort):
            return self._port.send_periodic(can_id, data, period_s, lease_s)
        period_ns, _ = lease_of(period_s, lease_s)
        task = LoopTask(self.send, can_id, data, period_ns)
        task.keep_alive()
        return task

    def drain(self) -> list[Frame]:
        """All frames that wait, oldest first, without blocking; raises BusLost when the bus has ended."""
        try:
            frames = self._port.drain_raw()
        except can.CanError as error:
            raise _translated(error, self.options) from None
        self.received += len(frames)
        return frames

    def receive(self, timeout_s: float | None) -> Frame | None:
        """The next frame; waits up to `timeout_s` (None: for ever), then None. Raises BusLost."""
        try:
            frame = self._port.recv_raw(timeout_s)
        except can.CanError as error:
            raise _translated(error, self.options) from None
        if frame is not None:
            self.received += 1
        return frame

    @property
    def sent(self) -> int:
        """Data frames that the bus has taken, without the kernel's periodic ones."""
        return self._taken - self.not_sent

    @property
    def not_sent(self) -> int:
        """Data frames discarded while the controller was bus-off."""
        return self._port.not_sent if isinstance(self._port, SocketCanPort) else 0

    @property
    def error_frames(self) -> int:
        """Error frames met so far."""
        return self._port.error_frames

    @property
    def bus_state(self) -> State:
        """State of the bus controller, as far as the error frames read so far tell it."""
        return getattr(self._port, "bus_state", State.ACTIVE)

    @property
    def error_counters(self) -> tuple[int, int] | None:
        """The controller's transmit and receive error counter (TEC, REC), None: never told."""
        return getattr(self._port, "error_counters", None)

    @property
    def last_error(self) -> ErrorFrame | None:
        """The last error frame, decoded; None: there was none, or the interface keeps none."""
        return getattr(self._port, "last_error", None)

    @property
    def dropped(self) -> int:
        """Frames known to be lost so far (the local bus loses none)."""
        return self._port.dropped if isinstance(self._port, ForeignPort | SocketCanPort) else 0

    def close(self) -> None:
        """Leave the bus. May be called several times."""
        with contextlib.suppress(can.CanError, OSError):
            self._port.shutdown()

    def __enter__(self) -> Transport:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def _open_port(options: BusOptions, name: str, wanted: frozenset[int] | None) -> Port:
    keywords: dict[str, Any] = dict(options.extra)
    if options.bitrate is not None:
        keywords["bitrate"] = options.bitrate
    if options.fd:
        keywords["fd"] = True
    if options.interface == LOCAL_INTERFACE:
        unknown = sorted(keywords.keys() - OPTIONS - IGNORED_OPTIONS)
        if unknown:
            raise BusOptionsError(f"{options}: no option '{unknown[0]}'; it has {', '.join(sorted(OPTIONS))}")
        try:
            check_channel(options.channel)
        except AddressError as error:
            raise BusOptionsError(str(error)) from None
        return HilBus(options.channel, can_filters=_exact_filters(wanted), **{"name": name, **keywords})
    if options.interface == "socketcan":
        _check_socketcan(options)
        return SocketCanPort(options.channel, wanted, fd=options.fd, extra=options.extra)
    bus = can.Bus(options.channel, options.interface, ignore_config=True, **keywords)
    return ForeignPort(bus, wanted, fd=options.fd, hears_itself=options.interface == "udp_multicast")


def _check_socketcan(options: BusOptions) -> None:
    instead = "or use the local bus: -i hil -c ato"
    name = options.channel
    if not has_socketcan():
        raise BusUnavailable(
            f"{options}: this kernel has no SocketCAN; load the modules can_raw and vcan, {instead}"
        )
    if not is_can_interface_up(name):
        virtual = f"'ip link add dev {name} type vcan; ip link set up {name}'"
        remedy = virtual if name.startswith("vcan") else f"'ip link set up {name} type can bitrate 500000'"
        raise BusUnavailable(f"{options}: there is no such interface that is up; {remedy}, {instead}")


def _exact_filters(wanted: frozenset[int] | None) -> Any:
    if wanted is None:
        return None
    if not wanted:
        return [{"can_id": INVERT, "can_mask": 0}]  # the inversion of "everything"; [] would be no filter
    return [
        {"can_id": can_id & ~EXTENDED_ID_FLAG, "can_mask": 0x1FFF_FFFF, "extended": True}
        if can_id & EXTENDED_ID_FLAG
        else {"can_id": can_id, "can_mask": 0x7FF, "extended": False}
        for can_id in sorted(wanted)
    ]


def _canonical(can_id: int) -> int:
    return can_id | EXTENDED_ID_FLAG if can_id > 0x7FF else can_id


@contextlib.contextmanager
def _translated_opening(options: BusOptions) -> Iterator[None]:
    # python-can also logs what it raises; without a handler of the program's that would be a second line.
    handler = logging.NullHandler()
    logging.getLogger("can").addHandler(handler)
    try:
        yield
    except can.CanInterfaceNotImplementedError as error:
        raise BusUnavailable(f"{options}: {_one_line(error)}{_remedy(options)}") from None
    except can.CanError as error:
        if options.interface == LOCAL_INTERFACE:
            raise BusUnavailable(_one_line(error)) from None
        cause = error.__cause__
        detail = f" ({_one_line(cause)})" if cause is not None else ""
        raise BusUnavailable(f"{options}: {_one_line(error)}{detail}{_remedy(options)}") from None
    except BusOptionsError:
        raise
    except (OSError, ImportError, NotImplementedError) as error:
        raise BusUnavailable(f"{options}: {_one_line(error)}{_remedy(options)}") from None
    except (ValueError, TypeError) as error:
        raise BusOptionsError(f"{options}: {_one_line(error)}") from None
    finally:
        logging.getLogger("can").removeHandler(handler)


def _remedy(options: BusOptions) -> str:
    if options.interface == "udp_multicast":
        return "; it needs the package msgpack, and a multicast route: ip route add 224.0.0.0/4 dev lo"
    return "; is its driver installed? The local bus needs none: -i hil -c ato"


def _translated(error: can.CanError, options: BusOptions) -> BusError:
    text = _one_line(error) if options.interface == LOCAL_INTERFACE else f"{options}: {_one_line(error)}"
    full = (
        isinstance(error, TransmitQueueFullError | can.CanTimeoutError)
        or error.error_code in _NO_BUFFER_SPACE
        or "buffer full" in text.lower()
    )
    if full:
        return TransmitQueueFull(text)
    return BusLost(text)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
