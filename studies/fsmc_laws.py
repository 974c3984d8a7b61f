"""The laws of the FSMC paper as printed, the form with an observer, and the masses they reckon with."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt
from typing import Literal

from controller.fuzzy.bases import fsmc_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.laws import Drive, Law
from controller.laws import fsmc as fuzzy_sliding_mode
from controller.laws import fsmc_eso as with_observer
from controller.laws import smc as sliding_mode

__all__ = [
    "ESO_PREVIEW_S",
    "MEAN_KG",
    "NOMINAL_KG",
    "fsmc",
    "fsmc_eso",
    "fsmc_eso_on_train",
    "smc",
    "surface",
]

NOMINAL_KG = 252_500.0
"""Mass that the FSMC reckons with: no other gives the paper's 3.12e5 N."""

MEAN_KG = sqrt(252_500.0 * 305_000.0)
"""Mass that the SMC reckons with: equation 16, geometric mean, 277 511 kg."""

ESO_PREVIEW_S = 0.347
"""How far ahead the form with an observer takes the reference's acceleration: drive lag, delay and hold."""


def smc(disturbance_mps2: float) -> Law:
    """Sliding mode (equations 16 to 21) with this bound of the disturbance."""
    return sliding_mode.Smc(replace(sliding_mode.PAPER, disturbance_mps2=disturbance_mps2))


def fsmc(*, s_in_kmh: bool) -> Law:
    """Fuzzy sliding mode (equations 31 to 34, Table 1), differencing s; `s_in_kmh`: another reading of s."""
    unit: Literal["m/s", "km/h"] = "km/h" if s_in_kmh else "m/s"
    return fuzzy_sliding_mode.Fsmc(replace(fuzzy_sliding_mode.PAPER, s_input_unit=unit))


def fsmc_eso() -> Law:
    """Fuzzy sliding mode with the extended-state observer, for this train behind a 100 Hz bus."""
    return with_observer.FsmcEso(with_observer.PAPER)


def fsmc_eso_on_train() -> Law:
    """The same law as `hil run` uses it: defaults for this train's drive, which is not tuned to this loop."""
    parameters = with_observer.FsmcEsoParameters(reported_effort=False)
    return with_observer.FsmcEso(parameters, Drive(0.01, 0.2))


def surface() -> CompiledRuleBase:
    """The paper's 25 rules: half ranges 0.75."""
    return CompiledRuleBase(fsmc_rules())
