"""Fault confinement of one CAN controller: error counters and states, ISO 11898-1:2015 clause 12.1.4.

And what a controller says of it: error frames as SocketCAN gives them to programs (linux/can/error.h).
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

WARNING_LIMIT = 96
PASSIVE_LIMIT = 128
BUS_OFF_LIMIT = 256
RECOVERY_SEQUENCES = 128
"""Sequences of 11 recessive bits after which a controller that was bus-off takes part again."""

RECOVERY_SEQUENCE_BITS = 11

# linux/can/error.h
ERR_CRTL = 0x004
ERR_PROT = 0x008
ERR_ACK = 0x020
ERR_BUSOFF = 0x040
ERR_BUSERROR = 0x080
ERR_RESTARTED = 0x100
ERR_CNT = 0x200
CRTL_RX_WARNING, CRTL_TX_WARNING = 0x04, 0x08
CRTL_RX_PASSIVE, CRTL_TX_PASSIVE = 0x10, 0x20
CRTL_ACTIVE = 0x40
PROT_BIT, PROT_STUFF, PROT_TX = 0x01, 0x04, 0x80
PROT_LOC_ACK = 0x19


class State(StrEnum):
    """What a controller may do on the bus; the names are those of `ip -details link show`."""

    ACTIVE = "error-active"
    WARNING = "error-warning"
    PASSIVE = "error-passive"
    BUS_OFF = "bus-off"


class Notice(NamedTuple):
    """What a controller reports of an error or a change of its state."""

    classes: int
    """Error classes, the identifier of SocketCAN's error frame without its flag."""
    data: bytes
    """The 8 data bytes of that error frame."""


class Confinement:
    """Error counters of one controller; each method returns what there is to report."""

    def __init__(self) -> None:
        self.tec = 0
        self.rec = 0
        self.state = State.ACTIVE

    def transmit_failed(self, *, acknowledge: bool) -> list[Notice]:
        """A frame of its own met an error; `acknowledge`: nobody acknowledged it."""
        if acknowledge and self.state is State.PASSIVE:
            # Exception 1 of rule c): a passive controller that is alone does not count, so it never leaves.
            return []
        self.tec += 8
        if acknowledge:
            notice = self._notice(ERR_ACK | ERR_BUSERROR, location=PROT_LOC_ACK)
        else:
            notice = self._notice(ERR_PROT | ERR_BUSERROR, kind=PROT_BIT | PROT_TX)
        return [notice, *self._follow()]

    def receive_failed(self) -> list[Notice]:
        """A frame of another controller met an error."""
        self.rec += 1
        return [self._notice(ERR_PROT | ERR_BUSERROR, kind=PROT_STUFF), *self._follow()]

    def transmitted(self) -> list[Notice]:
        """A frame of its own was sent."""
        if not self.tec:
            return []
        self.tec -= 1
        return self._follow()

    def received(self) -> list[Notice]:
        """A frame of another controller was received without an error."""
        if not self.rec:
            return []
        # Above 127 it is set to a value from 119 to 127.
        self.rec = 119 if self.rec >= PASSIVE_LIMIT else self.rec - 1
        return self._follow()

    def recovered(self) -> list[Notice]:
        """It was bus-off and takes part again, with both counters at 0."""
        self.tec = self.rec = 0
        self.state = State.ACTIVE
        return [self._notice(ERR_RESTARTED)]

    def _follow(self) -> list[Notice]:
        """The state that belongs to the counters, and a report if it is another one."""
        most = max(self.tec, self.rec)
        if self.tec >= BUS_OFF_LIMIT:
            state = State.BUS_OFF
        elif most >= PASSIVE_LIMIT:
            state = State.PASSIVE
        elif most >= WARNING_LIMIT:
            state = State.WARNING
        else:
            state = State.ACTIVE
        if state is self.state:
            return []
        self.state = state
        if state is State.BUS_OFF:
            return [self._notice(ERR_BUSOFF)]
        by_transmit, by_receive = {
            State.PASSIVE: (CRTL_TX_PASSIVE, CRTL_RX_PASSIVE),
            State.WARNING: (CRTL_TX_WARNING, CRTL_RX_WARNING),
        }.get(state, (CRTL_ACTIVE, CRTL_ACTIVE))
        controller = (by_transmit if self.tec >= self.rec else 0) | (
            by_receive if self.rec >= self.tec else 0
        )
        return [self._notice(ERR_CRTL, controller=controller)]

    def _notice(self, classes: int, *, controller: int = 0, kind: int = 0, location: int = 0) -> Notice:
        data = bytes((0, controller, kind, location, 0, 0, min(self.tec, 255), min(self.rec, 255)))
        return Notice(classes | ERR_CNT, data)
