"""Which law a scenario asks for, and its number on the bus (value table of `ATO_Status.Law`)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple, Protocol

from controller.config import ControllerConfig
from controller.laws import Drive, Law
from controller.laws.fsmc import Fsmc
from controller.laws.fsmc_eso import FsmcEso
from controller.laws.fuzzy_d import FuzzyD
from controller.laws.fuzzy_pid import FuzzyPid
from controller.laws.pid import Pid
from controller.laws.smc import Smc
from controller.laws.speedt import SpeedT


class MakeLaw(Protocol):
    """Makes a law from a configuration, for a train with this drive."""

    def __call__(self, config: ControllerConfig, drive: Drive = ..., /) -> Law:
        """A law as before its first step."""


class LawEntry(NamedTuple):
    """A law as it is chosen: its number on the bus, what it is, and how it is made."""

    number: int
    title: str
    make: MakeLaw


DRIVE = Drive()

LAWS: Mapping[str, LawEntry] = MappingProxyType(
    {
        "pid": LawEntry(
            1,
            "PID with feed-forward and clamping anti-windup",
            lambda config, _drive=DRIVE: Pid(config.pid.parameters()),
        ),
        "speedt": LawEntry(
            2,
            "SpeedT: 5x5 rule base of error and rate alone, with feed-forward",
            lambda config, _drive=DRIVE: SpeedT(config.speedt.parameters()),
        ),
        "fuzzy_d": LawEntry(
            3,
            "Fuzzy-D: 5x5 rule base, derivative, integral and feed-forward",
            lambda config, _drive=DRIVE: FuzzyD(config.fuzzy_d.parameters()),
        ),
        "fuzzy_pid": LawEntry(
            4,
            "Fuzzy PID: three 7x7 rule bases move the gains of a PID with feed-forward",
            lambda config, _drive=DRIVE: FuzzyPid(config.fuzzy_pid.parameters()),
        ),
        "smc": LawEntry(
            5,
            "Sliding mode with a boundary layer",
            lambda config, _drive=DRIVE: Smc(config.smc.parameters()),
        ),
        "fsmc": LawEntry(
            6,
            "Fuzzy sliding mode: 25 rules of the sliding surface and its rate",
            lambda config, _drive=DRIVE: Fsmc(config.fsmc.parameters()),
        ),
        "fsmc_eso": LawEntry(
            7,
            "Fuzzy sliding mode with an extended-state observer that knows the drive",
            lambda config, drive=DRIVE: FsmcEso(config.fsmc_eso.parameters(), drive),
        ),
    }
)
"""By the name that stands in `controller.law`."""
