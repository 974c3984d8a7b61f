"""E2E protection of a message, sender and receiver: AUTOSAR profile 1 (AUTOSAR FO PRS E2EProtocol).

The CRC-8 (SAE J1850 polynomial, over data ID, counter and data) comes from `autosar-e2e`; the receiver's
state machine is here. It finds corrupted, repeated, lost, re-ordered and masqueraded messages. A message is
taken whole or not at all.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from e2e.p01 import e2e_p01_check, e2e_p01_protect

from hil.canbus.signals import ProtectionSpec

COUNTER_MODULUS: Final = 15
"""Profile 1 counts 0 to 14; 15 marks an invalid counter and is never sent."""

NO_COUNTER: Final = 15
"""`Receiver.counter` before the first accepted message."""

FAULT_LIMIT: Final = 5
"""So many more rejected than good messages make a receiver faulty: one bad frame is no fault."""


class E2EStatus(IntEnum):
    """Result of one check; the numbers are those of the DBC's value table."""

    OK = 0
    REPEATED = 1
    OK_SOME_LOST = 2
    WRONG_SEQUENCE = 3
    WRONG_CRC = 4
    NO_NEW_DATA = 5
    INITIAL = 6


# names of this module: a lookup on the enumeration costs more than the arithmetic of `check`
_OK = E2EStatus.OK
_REPEATED = E2EStatus.REPEATED
_OK_SOME_LOST = E2EStatus.OK_SOME_LOST
_WRONG_SEQUENCE = E2EStatus.WRONG_SEQUENCE
_WRONG_CRC = E2EStatus.WRONG_CRC
_NO_NEW_DATA = E2EStatus.NO_NEW_DATA
_INITIAL = E2EStatus.INITIAL
_ACCEPTED = frozenset((_OK, _OK_SOME_LOST, _INITIAL))


class Protector:
    """The sender's side of one message: its counter. The first message carries counter 0."""

    __slots__ = ("_counter", "_data_id")

    def __init__(self, spec: ProtectionSpec) -> None:
        self._data_id = spec.data_id
        self._counter = COUNTER_MODULUS - 1

    def protect(self, data: bytearray) -> None:
        """Write counter and CRC into an encoded message, in place."""
        # the library increments what stands in the low nibble of byte 1, from 14 to 0
        data[1] = data[1] & 0xF0 | self._counter
        e2e_p01_protect(data, self._data_id)
        self._counter = data[1] & 0x0F


class Receiver:
    """The receiver's side of one message.

    `status`: of the last check. `counter`: of the last accepted message (`NO_COUNTER` before). `ok`,
    `rejected`: messages accepted and not. `lost`: counters missing from the sender's sequence, never seen or
    seen corrupted. `fault_counter`: +1 for a rejected message, -1 for an accepted one, 0 to `FAULT_LIMIT`.
    """

    __slots__ = (
        "_buffer",
        "_data_id",
        "_length",
        "_max_delta",
        "_reference",
        "counter",
        "fault_counter",
        "lost",
        "ok",
        "rejected",
        "status",
    )

    def __init__(self, spec: ProtectionSpec, *, length: int) -> None:
        self._data_id = spec.data_id
        self._max_delta = spec.max_delta_counter
        self._length = length
        self._buffer = bytearray(length)  # the library reads mutable buffers only
        self._reference = -1  # counter that the next one is compared with
        self.status: E2EStatus = _NO_NEW_DATA
        self.counter = NO_COUNTER
        self.ok = 0
        self.rejected = 0
        self.lost = 0
        self.fault_counter = 0

    def check(self, data: bytes | bytearray) -> E2EStatus:
        """Judge one received payload. A wrong length counts as WRONG_CRC.

        After WRONG_SEQUENCE the next consecutive counter is OK: a sender that restarts costs one message.
        """
        if len(data) != self._length:
            return self._reject(_WRONG_CRC)
        buffer = self._buffer
        buffer[:] = data
        if not e2e_p01_check(buffer, self._data_id):
            return self._reject(_WRONG_CRC)
        counter = buffer[1] & 0x0F
        reference = self._reference
        if reference < 0:
            status = _INITIAL
        else:
            delta = counter - reference
            if delta < 0:
                delta += COUNTER_MODULUS
            if delta == 1:
                status = _OK
            elif delta == 0:
                return self._reject(_REPEATED)
            else:
                self.lost += delta - 1
                if delta > self._max_delta:
                    self._reference = counter
                    return self._reject(_WRONG_SEQUENCE)
                status = _OK_SOME_LOST
        self._reference = self.counter = counter
        self.ok += 1
        if self.fault_counter:
            self.fault_counter -= 1
        self.status = status
        return status

    def no_new_data(self) -> None:
        """Nothing has arrived since the last cycle. Silence has its own limit (the message's timeout)."""
        self.status = _NO_NEW_DATA

    @property
    def faulty(self) -> bool:
        """True while `FAULT_LIMIT` more messages were rejected than accepted."""
        return self.fault_counter >= FAULT_LIMIT

    @staticmethod
    def accepted(status: E2EStatus) -> bool:
        """True if a message with this status is to be used."""
        return status in _ACCEPTED

    def _reject(self, status: E2EStatus) -> E2EStatus:
        self.rejected += 1
        if self.fault_counter < FAULT_LIMIT:
            self.fault_counter += 1
        self.status = status
        return status
