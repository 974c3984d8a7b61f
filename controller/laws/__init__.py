"""Control laws: each turns a reference and a measurement into an acceleration demand.

Every law has the same protocol, keeps its state inside and knows nothing of the bus, the drive or the
supervision. The resistance of train and track is added behind the law (see :mod:`controller.effort`),
so a law works in the train's own acceleration.
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple, Protocol


class Reference(NamedTuple):
    """What the plan wants at the measured position."""

    position_m: float
    speed_mps: float
    acceleration_mps2: float
    preview_mps2: float
    """Planned acceleration `lead_s` later: makes up for the dead time and lag of the drive."""


class Measurement(NamedTuple):
    """What the train does, and what it can do."""

    position_m: float
    speed_mps: float
    lowest_mps2: float
    """Least acceleration that full service braking reaches now (negative)."""
    highest_mps2: float
    """Most acceleration that full traction reaches now."""
    resistance_mps2: float = 0.0
    """Running resistance and track over the effective mass, which is added behind the law.

    Positive slows the train."""
    acceleration_mps2: float | None = None
    """True acceleration where somebody knows it (the plant of a study); None: the law uses the speed."""
    effort_mps2: float | None = None
    """What drive and brakes report to give now, over the effective mass; None: nothing is reported."""


class Drive(NamedTuple):
    """What lies between a demand and its effect: dead time, then a first-order lag.

    Below `fade_start_mps` the motors leave braking to the friction brake, which is slower; below
    `fade_end_mps` it brakes alone. The default is a drive without friction brake.
    """

    dead_time_s: float = 0.1
    lag_s: float = 0.4
    friction_dead_time_s: float = 0.2
    friction_lag_s: float = 0.6
    fade_start_mps: float = 0.0
    fade_end_mps: float = 0.0

    def friction_share(self, speed_mps: float) -> float:
        """Share of the braking that the friction brake does at this speed, 0 to 1."""
        span_mps = self.fade_start_mps - self.fade_end_mps
        if span_mps <= 0.0:
            return 0.0
        return min(1.0, max(0.0, (self.fade_start_mps - abs(speed_mps)) / span_mps))


class Law(Protocol):
    """One control law."""

    @property
    def probe_names(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of every inner value of `internals`."""

    def step(self, reference: Reference, measurement: Measurement, dt_s: float) -> float:
        """Acceleration demand [m/s2], within the measurement's lowest and highest."""

    def internals(self) -> tuple[float, ...]:
        """Inner values after the last step, in the order of `probe_names`."""

    def reset(self) -> None:
        """Forget everything: as before the first step."""


PAPER_CONTROL_MPS2 = 612.0 / 0.34 / 8621.0
"""Acceleration per unit of control of the Fuzzy-D paper's plant (its equation 4, at zero frequency): 0.2088.

Converts gains and membership functions that the paper gives in its own units of control."""


def carried_over(integral: float, before_mps2: float, now_mps2: float) -> float:
    """An integral when the plan's demand shrinks from `before_mps2` to `now_mps2`.

    What it has learned while braking or accelerating is mostly a factor: another mass, a weaker brake. So it
    shrinks with the demand; kept as it is, it would stop a train with weak brakes short of its stop.
    """
    before, now = max(abs(before_mps2), CARRY_FLOOR_MPS2), max(abs(now_mps2), CARRY_FLOOR_MPS2)
    return integral * now / before if now < before else integral


CARRY_FLOOR_MPS2 = 0.1
"""Below this demand the integral is kept: resistance and gradient are no factors of it."""


def speed_error(reference: Reference, measurement: Measurement) -> float:
    """Reference minus measured speed [m/s].

    Raises ValueError if it, a planned acceleration or the resistance is not finite: a lost sensor must not
    turn into a plausible demand, nor into an integral that is lost for good.
    """
    error = reference.speed_mps - measurement.speed_mps
    rest = reference.preview_mps2 + reference.acceleration_mps2 + measurement.resistance_mps2
    if not (isfinite(error) and isfinite(rest)):
        raise ValueError(
            f"law input not finite: speed {measurement.speed_mps} m/s, resistance "
            f"{measurement.resistance_mps2} m/s^2, reference {reference.speed_mps} m/s, "
            f"{reference.acceleration_mps2} and {reference.preview_mps2} m/s^2"
        )
    return error


def clamp(value: float, lowest: float, highest: float) -> float:
    """`value`, limited to [lowest, highest]."""
    if value < lowest:
        return lowest
    return min(value, highest)
