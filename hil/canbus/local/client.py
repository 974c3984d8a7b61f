"""Local bus, the client: python-can interface `hil`, and a fast path for nodes that need no `can.Message`."""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Iterable
from typing import Any

import can
from can.typechecking import AutoDetectedConfig, CanFilters

from hil.canbus.error_frames import ErrorFrame
from hil.canbus.frame import Frame
from hil.canbus.local import address, link, wire
from hil.canbus.local.confinement import State
from hil.canbus.local.filters import pack_filters
from hil.canbus.local.stream import NOT_DATA, HubLostError, Record, Stream, TransmitQueueFullError
from hil.canbus.local.wire import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    EXTENDED_MASK,
    FD,
    HEADER,
    OWN,
    REMOTE,
    STANDARD_MASK,
)

__all__ = [
    "DEFAULT_CHANNEL",
    "IGNORED_OPTIONS",
    "OPTIONS",
    "HilBus",
    "HubLostError",
    "TransmitQueueFullError",
]

DEFAULT_CHANNEL = "ato"

OPTIONS = {"receive_own_messages", "fd", "bitrate", "data_bitrate", "autostart", "name"}
"""What a bus of this interface can be opened with, besides channel and filters."""

IGNORED_OPTIONS = {
    "single_handle",
    "timing",
    "local_loopback",
    "ignore_rx_error_frames",
    "state",
}
"""What python-can's helpers or configuration files hand to every interface, without a meaning here."""

_LOG = logging.getLogger("can.hil")
_CLASSIC_LENGTH = 8


class HilBus(can.BusABC):
    """A client of the local bus, `can.Bus(interface="hil", channel="ato")`.

    Guarantees: no frame is lost, and all clients see all frames in the same order, that of their timestamps.
    A sender that is faster than the slowest receiver is held back. Own frames are received only when asked
    for, with `is_rx` false. Without a bit rate frames go as fast as they can. With one they take their exact
    time on the wire, the lowest identifier wins, and a frame is received (by its sender, too) when its last
    bit was sent; errors on the wire and bus-off arrive as error frames, as on SocketCAN.

    :param channel: name of the bus; clients of the same user with the same name are on one bus.
    :param can_filters: applied in the hub, with SocketCAN's meaning (error frames always pass).
    :param receive_own_messages: whether own frames come back, in the order that all see.
    :param fd: whether CAN FD frames can be sent and are received; without it they are left out.
    :param bitrate: of the bus [bit/s], all clients have to agree; None: whatever the bus has (a bus that is
        started by this client then has none).
    :param data_bitrate: likewise for CAN FD frames with bit-rate switch.
    :param autostart: start a hub when the channel has none; it ends 2 s after its last client left.
    :param name: how the hub names this client in its messages (default: the program's name).
    :raises ~can.exceptions.CanInitializationError: when the bus cannot be joined; one line that says why.
    """

    def __init__(
        self,
        channel: Any = DEFAULT_CHANNEL,
        can_filters: CanFilters | None = None,
        receive_own_messages: bool = False,
        fd: bool = False,
        bitrate: int | None = None,
        data_bitrate: int | None = None,
        autostart: bool = True,
        name: str | None = None,
        **kwargs: Any,
    ) -> None:
        for unknown in sorted(kwargs.keys() - IGNORED_OPTIONS):
            _LOG.warning("interface hil has no option '%s': ignored", unknown)
        self._hub_filters = pack_filters(can_filters or None)
        hello = {
            "name": name or os.path.basename(sys.argv[0]) or "python",
            "pid": os.getpid(),
            "receive_own": bool(receive_own_messages),
            "fd": bool(fd),
            "bitrate": None if bitrate is None else int(bitrate),
            "data_bitrate": None if data_bitrate is None else int(data_bitrate),
            "filters": self._hub_filters,
        }
        try:
            self.channel = address.check_channel(channel)
            self._stream = Stream(self.channel, hello, autostart=bool(autostart))
        except (address.AddressError, link.JoinError, wire.WireError) as error:
            raise can.CanInitializationError(str(error)) from None
        self._is_filtered = True
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self.channel_info = f"hil channel '{self.channel}'" + (
            "" if self._stream.bitrate is None else f" ({self._stream.bitrate} bit/s)"
        )
        super().__init__(channel=self.channel, can_filters=can_filters)

    # -- python-can ----------------------------------------------------------------------------------------

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a message; waits up to `timeout` s (None: for ever) while the transmit queue is full.

        :raises ~can.exceptions.CanOperationError: transmit queue full, hub ended, or no valid message.
        """
        self._stream.send(self._record(msg), timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        record = self._stream.receive(timeout, read_ahead=False)
        return (None if record is None else self._message(record)), True

    def _apply_filters(self, filters: CanFilters | None) -> None:
        packed = pack_filters(filters)
        if packed == self._hub_filters:
            return
        try:
            self._stream.push_filters(packed)
        except wire.WireError as error:
            raise can.CanOperationError(f"{self.channel_info}: too many filters: {error}") from None
        self._hub_filters = packed

    def fileno(self) -> int:
        """The socket's file number, readable when a message waits; -1 when the bus is closed."""
        return self._stream.fileno()

    def shutdown(self) -> None:
        """Leave the bus. May be called several times."""
        super().shutdown()
        self._stream.close()

    @staticmethod
    def _detect_available_configs() -> list[AutoDetectedConfig]:
        try:
            return [{"interface": "hil", "channel": channel} for channel in address.channels()]
        except address.AddressError:
            return []

    # -- fast path -----------------------------------------------------------------------------------------

    def send_raw(self, can_id: int, data: bytes | bytearray, timeout: float | None = 0.0) -> None:
        """Send a data frame: 11-bit identifier, or a 29-bit one with `EXTENDED_ID_FLAG` (or above 0x7FF).

        More than 8 bytes make it a CAN FD frame. Waits up to `timeout` s (None: for ever) while the transmit
        queue is full; raises can.CanOperationError like `send`, ValueError when the data are too long.
        """
        self._stream.send(self._raw_record(can_id, data), timeout)

    def send_raw_all(
        self, frames: Iterable[tuple[int, bytes | bytearray]], timeout: float | None = 0.0
    ) -> None:
        """Send data frames in this order, nothing of others in between; all of them or none.

        One system call for all, and one wake-up of the hub: for what a node says at the end of a cycle.
        """
        pack = HEADER.pack
        pieces: list[bytes | bytearray] = []
        for can_id, data in frames:
            length = len(data)
            if can_id <= STANDARD_MASK and length <= _CLASSIC_LENGTH:
                pieces += (pack(0, can_id, length, 0, length), data)
            else:
                pieces.append(self._raw_record(can_id, data))
        if pieces:
            self._stream.send(b"".join(pieces), timeout)

    def drain_raw(self) -> list[Frame]:
        """All data frames that wait, without blocking; raises can.CanOperationError when the hub has ended.

        Remote frames are left out, error frames are counted in `error_frames`.
        """
        return self._stream.drain()

    def recv_raw(self, timeout: float | None = None) -> Frame | None:
        """The next data frame; waits up to `timeout` s (None: for ever), then returns None.

        Reads ahead: do not mix it with a `can.Notifier` on the same bus.
        """
        deadline_s = None if timeout is None else time.monotonic() + timeout
        while True:
            record = self._stream.receive(timeout, read_ahead=True)
            if record is None:
                return None
            stamp_ns, can_id, data, _, _ = record
            if not can_id & NOT_DATA:
                return Frame(stamp_ns, can_id, data)
            if can_id & ERROR:
                self._stream.note_error(can_id, data)
            if deadline_s is not None:
                timeout = max(0.0, deadline_s - time.monotonic())

    @property
    def error_frames(self) -> int:
        """Error frames that `drain_raw` and `recv_raw` have met and left out."""
        return self._stream.error_frames

    @property
    def bus_state(self) -> State:
        """State of this client's error confinement, as the error frames told it."""
        return self._stream.bus_state

    @property
    def error_counters(self) -> tuple[int, int] | None:
        """Transmit and receive error counter that an error frame told last."""
        return self._stream.error_counters

    @property
    def last_error(self) -> ErrorFrame | None:
        """The last error frame that `drain_raw` or `recv_raw` has met, decoded."""
        return self._stream.last_error

    @property
    def tx_pending(self) -> int:
        """Frames of this client that still wait for the wire, as far as it has read; 0 without a bit rate."""
        return self._stream.credit.pending

    def statistics(self) -> dict[str, Any]:
        """What the hub knows: frames forwarded, clients, their backlogs; raises can.CanOperationError."""
        try:
            return link.query(self.channel)
        except (OSError, wire.WireError) as error:
            raise can.CanOperationError(f"{self.channel_info}: no statistics: {error}") from None

    def _raw_record(self, can_id: int, data: bytes | bytearray) -> bytes:
        length = len(data)
        if can_id > STANDARD_MASK:
            can_id = EXTENDED | (can_id & EXTENDED_MASK)
        if length <= _CLASSIC_LENGTH:
            return HEADER.pack(0, can_id, length, 0, length) + data
        if length > wire.MAX_DATA_LENGTH or self._can_protocol is not can.CanProtocol.CAN_FD:
            raise ValueError(f"{self.channel_info}: {length} data bytes; 8 fit, 64 with CAN FD (option fd)")
        return HEADER.pack(0, can_id, length, FD, length) + data

    # -- messages ------------------------------------------------------------------------------------------

    def _record(self, msg: can.Message) -> bytes:
        can_id, length = msg.arbitration_id, msg.dlc
        limit = EXTENDED_MASK if msg.is_extended_id else STANDARD_MASK
        if not 0 <= can_id <= limit:
            raise can.CanOperationError(
                f"{self.channel_info}: identifier {can_id:#x} is not in 0..{limit:#x}"
            )
        self._check_length(length, is_fd=msg.is_fd)
        if msg.is_extended_id:
            can_id |= EXTENDED
        if msg.is_error_frame:
            can_id |= ERROR
        if msg.is_remote_frame:
            return HEADER.pack(0, can_id | REMOTE, 0, 0, length)
        flags = 0
        if msg.is_fd:
            flags = FD | (BRS if msg.bitrate_switch else 0) | (ESI if msg.error_state_indicator else 0)
        data = bytes(msg.data)
        if len(data) != length:
            data = data[:length].ljust(length, b"\0")
        return HEADER.pack(0, can_id, length, flags, length) + data

    def _check_length(self, length: int, *, is_fd: bool) -> None:
        if is_fd and self._can_protocol is not can.CanProtocol.CAN_FD:
            raise can.CanOperationError(f"{self.channel_info}: CAN FD frames need the option fd=True")
        longest = wire.MAX_DATA_LENGTH if is_fd else _CLASSIC_LENGTH
        if not 0 <= length <= longest:
            raise can.CanOperationError(f"{self.channel_info}: {length} data bytes, at most {longest} fit")

    def _message(self, record: Record) -> can.Message:
        stamp_ns, can_id, data, flags, dlc = record
        return can.Message(
            timestamp=stamp_ns / 1e9,
            arbitration_id=can_id & EXTENDED_MASK,
            is_extended_id=bool(can_id & EXTENDED),
            is_remote_frame=bool(can_id & REMOTE),
            is_error_frame=bool(can_id & ERROR),
            channel=self.channel,
            dlc=dlc,
            data=bytearray(data),
            is_fd=bool(flags & FD),
            is_rx=not flags & OWN,
            bitrate_switch=bool(flags & BRS),
            error_state_indicator=bool(flags & ESI),
        )
