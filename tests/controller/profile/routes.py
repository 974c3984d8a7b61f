"""Random metro routes: what a speed-profile solver has to take whatever comes."""

from __future__ import annotations

import numpy as np

from controller.profile.mesh import mesh
from controller.profile.problem import Efforts, Problem
from hil.railway import DavisCoefficients
from hil.railway.resistance import davis_from_kmh

MASS_KG = 142_360.0
DAVIS = DavisCoefficients(*davis_from_kmh(1.75, 0.0234, 0.000184, MASS_KG))


def random_route(seed: int, *, max_step_m: float = 10.0, length_m: float | None = None) -> Problem:
    """Route of 0.6 to 4 km or `length_m`, +-30 permille, limits of 9 to 20 m/s; 1000 s, to be replaced."""
    rng = np.random.default_rng(seed)
    drawn = float(rng.uniform(600.0, 4000.0))
    length = drawn if length_m is None else length_m
    slopes = _corners(rng, length)
    limits = _corners(rng, length)
    permille = rng.uniform(-30.0, 30.0, len(slopes) - 1)
    speeds = rng.uniform(9.0, 20.0, len(limits) - 1)
    nodes = mesh(0.0, length, [*slopes, *limits], max_step_m)
    middles = 0.5 * (nodes[1:] + nodes[:-1])
    regeneration = float(rng.choice([0.0, 0.5, 0.8]))
    power = rng.choice([0.0, 2.2e6])
    return Problem(
        position_m=nodes,
        speed_limit_mps=speeds[np.searchsorted(limits, middles) - 1],
        track_n_per_kn=permille[np.searchsorted(slopes, middles) - 1],
        mass_kg=MASS_KG,
        effective_mass_kg=MASS_KG,
        davis=DAVIS,
        traction=Efforts(None, float(power) or None),
        max_acceleration_mps2=1.1,
        max_deceleration_mps2=1.4,
        regeneration_efficiency=regeneration,
        time_s=1000.0,
    )


def allowance(seed: int) -> float:
    """Trip time over the least one, 1.01 to 1.6."""
    return float(np.random.default_rng([seed, 1]).uniform(1.01, 1.6))


def _corners(rng: np.random.Generator, length_m: float) -> np.ndarray:
    inner = np.cumsum(rng.uniform(80.0, 500.0, max(60, int(length_m / 100.0))))
    return np.concatenate(([0.0], inner[inner < length_m - 30.0], [length_m]))
