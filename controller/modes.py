"""Modes of the ATO unit: a plain state machine whose transitions are data.

    STANDBY -> READY -> RUN -> STOPPING -> HOLD
                         |  ^     |
                         v  |     v
                        DEGRADED          any mode -> EMERGENCY -> STANDBY

Numbers equal the value table of `ATO_Command.Mode` in the bus contract.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Mode(IntEnum):
    """What the unit is doing."""

    STANDBY = 0
    """Waits for valid inputs; holding brake applied."""
    READY = 1
    """Everything is there, the train stands; waits for closed doors and the order to depart."""
    RUN = 2
    """Follows the profile."""
    STOPPING = 3
    """Follows the braking curve to the stop point."""
    HOLD = 4
    """Stands at the stop, holding brake applied; the end of a journey."""
    DEGRADED = 5
    """Supervision overrides the law with the service brake."""
    EMERGENCY = 6
    """Emergency brake applied."""


DRIVING = frozenset({Mode.RUN, Mode.STOPPING, Mode.DEGRADED})
"""Modes in which the train may move under this unit's command."""


@dataclass(slots=True)
class Conditions:
    """What the transitions depend on; refilled in every cycle."""

    emergency: bool = False
    """Supervision orders the emergency brake."""
    overridden: bool = False
    """Supervision orders the service brake."""
    inputs_valid: bool = False
    """All units' messages are there, valid and fresh."""
    standstill: bool = False
    departure: bool = False
    """Doors closed and departure authorised."""
    braking_to_stop: bool = False
    """The plan has begun its last braking."""
    arrived: bool = False
    """The train stands within the stop window, or past the stop by less than counts as an overrun."""


@dataclass(frozen=True)
class Transition:
    """From `mode` to `then` if every condition in `when` holds and none in `unless`."""

    mode: Mode
    then: Mode
    when: tuple[str, ...]
    unless: tuple[str, ...] = ()


TRANSITIONS: tuple[Transition, ...] = (
    Transition(Mode.STANDBY, Mode.EMERGENCY, ("emergency",)),
    Transition(Mode.STANDBY, Mode.READY, ("inputs_valid", "standstill"), ("overridden",)),
    Transition(Mode.READY, Mode.EMERGENCY, ("emergency",)),
    Transition(Mode.READY, Mode.STANDBY, (), ("inputs_valid",)),
    Transition(Mode.READY, Mode.STANDBY, ("overridden",)),
    Transition(Mode.READY, Mode.RUN, ("departure",)),
    Transition(Mode.RUN, Mode.EMERGENCY, ("emergency",)),
    Transition(Mode.RUN, Mode.DEGRADED, ("overridden",)),
    Transition(Mode.RUN, Mode.HOLD, ("arrived",)),
    Transition(Mode.RUN, Mode.STOPPING, ("braking_to_stop",)),
    Transition(Mode.STOPPING, Mode.EMERGENCY, ("emergency",)),
    Transition(Mode.STOPPING, Mode.DEGRADED, ("overridden",)),
    Transition(Mode.STOPPING, Mode.HOLD, ("arrived",)),
    Transition(Mode.HOLD, Mode.EMERGENCY, ("emergency",)),
    Transition(Mode.DEGRADED, Mode.EMERGENCY, ("emergency",)),
    Transition(Mode.DEGRADED, Mode.HOLD, ("arrived",)),
    Transition(Mode.DEGRADED, Mode.STOPPING, ("braking_to_stop",), ("overridden",)),
    Transition(Mode.DEGRADED, Mode.RUN, (), ("overridden",)),
    Transition(Mode.EMERGENCY, Mode.STANDBY, ("standstill",), ("emergency",)),
)
"""First match wins; no match stays."""

_BY_MODE = {mode: tuple(t for t in TRANSITIONS if t.mode is mode) for mode in Mode}


def next_mode(mode: Mode, conditions: Conditions) -> Mode:
    """The mode after one cycle under these conditions."""
    for transition in _BY_MODE[mode]:
        for name in transition.when:
            if not getattr(conditions, name):
                break
        else:
            for name in transition.unless:
                if getattr(conditions, name):
                    break
            else:
                return transition.then
    return mode
