"""Shared by the tests of the plant: trains, lines, and a scripted driver that needs no bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from hil.railway import (
    DavisCoefficients,
    EffortCurve,
    ElectrodynamicBrake,
    Gradient,
    Line,
    PneumaticBrake,
    Stop,
    TractionDrive,
    Train,
    load_line,
    load_train,
)
from hil.railway.library import find_line, find_train
from plant_sim.brakes import BrakeControl
from plant_sim.compiled import KernelDynamics, Motion
from plant_sim.config import CommandTable
from plant_sim.dynamics import Orders
from plant_sim.vehicle import Vehicle

CYCLE_S = 0.01
SUBSTEPS = 10


@dataclass(frozen=True)
class ScriptedRun:
    """What a scripted run did: orders of each cycle, and the state after each cycle."""

    orders: list[Orders]
    motions: list[Motion]

    def column(self, name: str) -> np.ndarray:
        return np.array([getattr(motion, name) for motion in self.motions])


def drive(
    vehicle: Vehicle,
    script: Sequence[tuple[float, float]],
    *,
    start_m: float = 0.0,
    pneumatic_n: float = 0.0,
    dynamics: KernelDynamics | None = None,
) -> ScriptedRun:
    """Run (duration in s, demand) pieces through blending and kernel, as the unit does."""
    dynamics = dynamics or KernelDynamics(vehicle, start_m, CYCLE_S / SUBSTEPS, pneumatic_n)
    brakes = BrakeControl(vehicle.train, CommandTable(), vehicle.deviations)
    run = ScriptedRun([], [])
    motion = dynamics.motion
    for duration_s, demand in script:
        for _ in range(round(duration_s / CYCLE_S)):
            friction_n = brakes.blended_n(demand, motion.speed_mps) if demand < 0.0 else 0.0
            orders = Orders(demand, True, friction_n, motion.speed_mps == 0.0)
            motion = dynamics.advance(orders, SUBSTEPS)
            run.orders.append(orders)
            run.motions.append(motion)
    return run


@pytest.fixture
def scripted() -> Callable[..., ScriptedRun]:
    return drive


@pytest.fixture(scope="session")
def urban() -> Train:
    return load_train(find_train("urban_4car_80m"))


@pytest.fixture(scope="session")
def cat_linh() -> Train:
    return load_train(find_train("cat_linh_4car"))


@pytest.fixture(scope="session")
def paper_line() -> Line:
    return load_line(find_line("fuzzy_d_2km"))


@pytest.fixture(scope="session")
def cat_linh_line() -> Line:
    return load_line(find_line("cat_linh_la_thanh"))


@pytest.fixture(scope="session")
def level() -> Line:
    return Line(name="level", start_m=-1000.0, end_m=20_000.0, default_limit_mps=40.0)


@pytest.fixture(scope="session")
def slope() -> Callable[[float], Line]:
    """A line of one gradient everywhere."""

    def build(permille: float) -> Line:
        return Line(
            name="slope",
            start_m=-1000.0,
            end_m=20_000.0,
            default_limit_mps=40.0,
            stops=(Stop("here", 0.0), Stop("there", 5000.0)),
            gradients=(Gradient(-1000.0, 20_000.0, permille),),
        )

    return build


@pytest.fixture(scope="session")
def ideal() -> Train:
    """100 t, no resistance, no dead time, drives of 1 ms, no rate limit worth the name, ample adhesion."""
    return Train(
        name="ideal",
        mass_kg=100_000.0,
        length_m=50.0,
        davis=DavisCoefficients(0.0, 0.0, 0.0),
        traction=TractionDrive(EffortCurve(100_000.0), 0.01, 0.0, 1e6),
        electrodynamic=ElectrodynamicBrake(EffortCurve(100_000.0), 0.01, 0.0, 1e6, 2.0, 0.5),
        pneumatic=PneumaticBrake(120_000.0, 0.01, 0.0, 130_000.0, 50_000.0),
        max_acceleration_mps2=1.0,
        max_braking_mps2=1.0,
        comfort_jerk_mps3=1.0,
    )
