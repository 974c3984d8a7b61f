"""The controllers of the Fuzzy-D paper: our laws with its gains, for its plant and for a train."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from controller.laws import Law, fuzzy_d, pid, speedt

__all__ = ["TITLES", "ideal_derivative_pid", "paper_laws", "train_laws"]

TITLES: Mapping[str, str] = MappingProxyType({"pid": "PID", "speedt": "SpeedT", "fuzzy_d": "Fuzzy-D"})


def paper_laws() -> dict[str, Law]:
    """PID, SpeedT and Fuzzy-D as printed: their demand is the paper's control u."""
    return {
        "pid": pid.Pid(pid.PAPER),
        "speedt": speedt.SpeedT(speedt.PAPER),
        "fuzzy_d": fuzzy_d.FuzzyD(fuzzy_d.PAPER),
    }


def ideal_derivative_pid() -> Law:
    """The paper's PID with a derivative filter too fast to matter."""
    return pid.Pid(replace(pid.PAPER, derivative_filter_per_s=500.0))


def train_laws() -> dict[str, Law]:
    """The same gains in acceleration units; the error's rate unfiltered, as a study knows it exactly."""
    return {
        "pid": pid.Pid(pid.PAPER_ON_TRAIN),
        "speedt": speedt.SpeedT(replace(speedt.PAPER_ON_TRAIN, rate_filter_s=0.0)),
        "fuzzy_d": fuzzy_d.FuzzyD(replace(fuzzy_d.PAPER_ON_TRAIN, rate_filter_s=0.0)),
    }
