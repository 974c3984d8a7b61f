"""What an error frame of SocketCAN says (linux/can/error.h): error classes, controller state, error counters.

A driver reports errors on the wire, and changes of its controller's state, as frames with the flag
CAN_ERR_FLAG; the local bus with a bit rate gives the same ones.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.canbus.local.confinement import PASSIVE_LIMIT, WARNING_LIMIT, State

__all__ = ["ERROR_FLAG", "ErrorFrame", "State", "decode_error_frame", "error_counters", "state_after"]

ERROR_FLAG = 0x2000_0000
_LOST_ARBITRATION, _CONTROLLER, _PROTOCOL, _TRANSCEIVER = 0x002, 0x004, 0x008, 0x010
_BUS_OFF, _RESTARTED, _COUNTERS = 0x040, 0x100, 0x200

_CLASSES = {
    0x001: "transmit timeout",
    _LOST_ARBITRATION: "lost arbitration",
    _CONTROLLER: "controller",
    _PROTOCOL: "protocol violation",
    _TRANSCEIVER: "transceiver",
    0x020: "no acknowledgement",
    _BUS_OFF: "bus-off",
    0x080: "bus error",
    _RESTARTED: "controller restarted",
    _COUNTERS: "error counters",
}
_CONTROLLER_STATUS = {
    0x01: "receive buffer overflow",
    0x02: "transmit buffer overflow",
    0x04: "receive errors: warning",
    0x08: "transmit errors: warning",
    0x10: "receive errors: passive",
    0x20: "transmit errors: passive",
    0x40: "error-active again",
}
_WARNING_BITS, _PASSIVE_BITS, _ACTIVE_BIT = 0x0C, 0x30, 0x40
_VIOLATIONS = {
    0x01: "single bit",
    0x02: "frame format",
    0x04: "bit stuffing",
    0x08: "dominant bit not sent",
    0x10: "recessive bit not sent",
    0x20: "overload",
    0x40: "active error announcement",
    0x80: "on transmission",
}
_LOCATIONS = {
    0x03: "start of frame",
    0x02: "identifier bits 28-21",
    0x06: "identifier bits 20-18",
    0x04: "substitute RTR",
    0x05: "identifier extension",
    0x07: "identifier bits 17-13",
    0x0F: "identifier bits 12-5",
    0x0E: "identifier bits 4-0",
    0x0C: "RTR",
    0x0D: "reserved bit 1",
    0x09: "reserved bit 0",
    0x0B: "data length code",
    0x0A: "data",
    0x08: "CRC",
    0x18: "CRC delimiter",
    0x19: "acknowledge slot",
    0x1B: "acknowledge delimiter",
    0x1A: "end of frame",
    0x12: "intermission",
}
_WIRES = {
    0x04: "CANH broken",
    0x05: "CANH shorted to battery",
    0x06: "CANH shorted to supply",
    0x07: "CANH shorted to ground",
    0x40: "CANL broken",
    0x50: "CANL shorted to battery",
    0x60: "CANL shorted to supply",
    0x70: "CANL shorted to ground",
    0x80: "CANL shorted to CANH",
}


@dataclass(frozen=True, slots=True)
class ErrorFrame:
    """One error frame. `classes` are the error classes it names, `details` what its data say of them.

    `state` is the state that the controller is in afterwards, None when the frame does not tell. `tx_errors`
    and `rx_errors` are the controller's error counters (TEC, REC), None when the driver does not give them.
    """

    classes: tuple[str, ...]
    details: tuple[str, ...]
    state: State | None
    tx_errors: int | None
    rx_errors: int | None

    @property
    def is_bus_off(self) -> bool:
        """Whether the controller says that it has left the bus."""
        return self.state is State.BUS_OFF

    def __str__(self) -> str:
        text = ", ".join(self.classes) or "no error class"
        if self.details:
            text += f" ({'; '.join(self.details)})"
        if self.tx_errors is None:
            return text
        return f"{text}; {self.tx_errors} transmit errors, {self.rx_errors} receive errors"


def decode_error_frame(can_id: int, data: bytes) -> ErrorFrame:
    """Decode an error frame: `can_id` with or without its flag, 8 data bytes (missing ones count as 0)."""
    can_id &= ~ERROR_FLAG
    data = bytes(data[:8]).ljust(8, b"\0")
    details: list[str] = []
    if can_id & _LOST_ARBITRATION and data[0]:
        details.append(f"at bit {data[0]}")
    if can_id & _CONTROLLER:
        details += [text for bit, text in _CONTROLLER_STATUS.items() if data[1] & bit]
    if can_id & _PROTOCOL:
        details += [text for bit, text in _VIOLATIONS.items() if data[2] & bit]
        if data[3]:
            details.append(f"at {_LOCATIONS.get(data[3], f'location {data[3]:#04x}')}")
    if can_id & _TRANSCEIVER and data[4]:
        details.append(_WIRES.get(data[4], f"status {data[4]:#04x}"))
    counters = error_counters(can_id, data)
    return ErrorFrame(
        classes=tuple(text for bit, text in _CLASSES.items() if can_id & bit),
        details=tuple(details),
        state=state_after(can_id, data),
        tx_errors=None if counters is None else counters[0],
        rx_errors=None if counters is None else counters[1],
    )


def error_counters(can_id: int, data: bytes) -> tuple[int, int] | None:
    """Transmit and receive error counter (TEC, REC) that the frame gives, or None. `data`: 8 bytes."""
    # Drivers older than CAN_ERR_CNT (Linux 6.0) put the counters there without saying so.
    told = can_id & _COUNTERS or (can_id & _CONTROLLER and (data[6] or data[7]))
    return (data[6], data[7]) if told else None


def state_after(can_id: int, data: bytes) -> State | None:
    """The state in which the controller is afterwards, None when the frame does not tell. `data`: 8 bytes."""
    if can_id & _BUS_OFF:
        return State.BUS_OFF
    if can_id & _RESTARTED:
        return State.ACTIVE
    if can_id & _CONTROLLER:
        if data[1] & _PASSIVE_BITS:
            return State.PASSIVE
        if data[1] & _WARNING_BITS:
            return State.WARNING
        if data[1] & _ACTIVE_BIT:
            return State.ACTIVE
    if can_id & _COUNTERS:
        # The counters are one byte each: bus-off, above 255, is told by its class alone.
        errors = max(data[6], data[7])
        if errors >= PASSIVE_LIMIT:
            return State.PASSIVE
        return State.WARNING if errors >= WARNING_LIMIT else State.ACTIVE
    return None
