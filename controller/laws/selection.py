"""Which law a scenario asks for, and its number on the bus (value table of `ATO_Status.Law`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from controller.config import ControllerConfig
from controller.laws import Law
from controller.laws.fuzzy_d import FuzzyD
from controller.laws.pid import Pid


class LawEntry(NamedTuple):
    """A law as it is chosen: its number on the bus, what it is, and how it is made."""

    number: int
    title: str
    make: Callable[[ControllerConfig], Law]


LAWS: Mapping[str, LawEntry] = MappingProxyType(
    {
        "pid": LawEntry(
            1, "PID with feed-forward and clamping anti-windup", lambda config: Pid(config.pid.parameters())
        ),
        "fuzzy_d": LawEntry(
            3,
            "Fuzzy-D: 5x5 rule base, derivative, integral and feed-forward",
            lambda config: FuzzyD(config.fuzzy_d.parameters()),
        ),
    }
)
"""By the name that stands in `controller.law`."""
