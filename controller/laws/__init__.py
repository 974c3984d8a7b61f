"""Control laws: each turns a reference and a measurement into an acceleration demand.

Every law has the same protocol, keeps its state inside and knows nothing of the bus, the drive or the
supervision. The resistance of train and track is added behind the law (see :mod:`controller.effort`),
so a law works in the train's own acceleration.
"""

from __future__ import annotations

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


def carried_over(integral: float, before_mps2: float, now_mps2: float) -> float:
    """An integral when the plan's demand shrinks from `before_mps2` to `now_mps2`.

    What it has learned while braking or accelerating is mostly a factor: another mass, a weaker brake. So it
    shrinks with the demand; kept as it is, it would stop a train with weak brakes short of its stop.
    """
    before, now = max(abs(before_mps2), CARRY_FLOOR_MPS2), max(abs(now_mps2), CARRY_FLOOR_MPS2)
    return integral * now / before if now < before else integral


CARRY_FLOOR_MPS2 = 0.1
"""Below this demand the integral is kept: resistance and gradient are no factors of it."""


def clamp(value: float, lowest: float, highest: float) -> float:
    """`value`, limited to [lowest, highest]."""
    if value < lowest:
        return lowest
    return min(value, highest)
