"""Sets of trains that a law must cope with: which settings of a scenario are drawn, from where to where.

A draw is a dict of settings, `dotted.key -> value`, as `--set` takes them. It follows from the set, the seed
and its number alone, so every law meets the same trains, and more runs only add to fewer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from hil.bench.errors import ScenarioError


@dataclass(frozen=True)
class Uniform:
    """A setting drawn evenly between two values, and why just these. `low == high`: it is fixed."""

    key: str
    low: float
    high: float
    source: str


@dataclass(frozen=True)
class Draw:
    """One train of a set: what differs from the scenario."""

    number: int
    settings: Mapping[str, float]

    def overrides(self) -> tuple[str, ...]:
        """The settings as `load_scenario` takes them."""
        return tuple(f"{key}={value!r}" for key, value in self.settings.items())


SPEC = (
    Uniform("plant.train.mass_factor", 0.8, 1.2, "empty to crush load; FSMC paper: 252.5 t to 305 t, +21 %"),
    Uniform("plant.train.brake_factor", 0.8, 1.2, "friction of pads and discs, and brake resistors, +-20 %"),
    Uniform("bus.loss_probability", 0.01, 0.01, "one frame in a hundred; a bus in good order loses none"),
)

FULL = (
    *SPEC,
    Uniform("plant.train.traction_factor", 0.9, 1.1, "effort of a drive against its map, +-10 %"),
    Uniform("plant.train.time_constant_factor", 0.625, 1.5, "drive lag 0.25 to 0.6 s where 0.4 s is nominal"),
    Uniform("plant.train.dead_time_factor", 0.5, 2.0, "dead time 0.05 to 0.2 s where 0.1 s is nominal"),
    Uniform("plant.train.gradient_factor", 0.8, 1.2, "slope against the line's data, +-20 %"),
    Uniform("plant.train.davis_factor", 0.7, 1.3, "running resistance: wind, cold, wear, +-30 %"),
    Uniform("plant.train.friction_brake_factor", 0.8, 1.2, "friction against electrodynamic brake, +-20 %"),
    Uniform("plant.train.friction_time_constant_factor", 0.833, 1.667, "0.5 to 1.0 s where 0.6 s is nominal"),
    Uniform("plant.odometry.wheel_diameter_error", -0.005, 0.005, "wear between two turnings of the wheel"),
    Uniform("plant.odometry.speed_noise_mps", 0.005, 0.005, "about two steps of 0.01 km/h"),
)

SETS: Mapping[str, tuple[Uniform, ...]] = MappingProxyType({"spec": SPEC, "full": FULL})
"""`spec`: what a specification demands. `full`: that, and all else that is not known of a real train."""

NOMINAL = Draw(0, {})
"""The scenario as it stands."""

LARGEST_SEED = 2**31 - 1


def draws(set_name: str, count: int, seed: int) -> tuple[Draw, ...]:
    """So many draws of a set, numbered from 1; each also has a seed of its own for noise and loss.

    ScenarioError: no such set.
    """
    if set_name not in SETS:
        raise ScenarioError(f"--set-of {set_name}: no such set; there are {', '.join(SETS)}")
    return tuple(_draw(SETS[set_name], number, seed) for number in range(1, count + 1))


def _draw(settings: tuple[Uniform, ...], number: int, seed: int) -> Draw:
    random = np.random.default_rng((seed, number))
    own_seed = int(random.integers(1, LARGEST_SEED))
    # One number for each, fixed ones too: what `full` adds does not change what `spec` has drawn.
    values = {
        setting.key: round(float(setting.low + (setting.high - setting.low) * random.random()), 6)
        for setting in settings
    }
    return Draw(number, {"journey.seed": own_seed, **values})
