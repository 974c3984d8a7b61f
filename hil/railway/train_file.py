"""A train file: TOML to `Train`. Masses in t, efforts in kN, power in kW, speeds in km/h.

TTOBench JSON is read as well, see `ttobench`.

schema = 1
name = "example"
title = "Four cars"
source = "where the numbers come from"
mass_t = 160.0
rotating_mass_factor = 0.08               # inertia of rotating parts, fraction of the mass
length_m = 80.0
powered_mass_fraction = 0.5               # share of the weight on motored axles
starting_resistance_n_per_kn = 0.0        # optional
max_acceleration_mps2 = 1.0
max_braking_mps2 = 1.3                    # full service brake
comfort_jerk_mps3 = 0.7
max_speed_kmh = 80.0                      # optional; of the vehicle, whatever the line permits
traction_efficiency = 0.85                # optional, 1.0; wheel rim over line
regeneration_efficiency = 0.70            # optional, 0.0; back to the line over braking work

[davis]                                   # a + b v + c v^2 in N, v in m/s; or instead of it
a_n = 2965.0                              # [specific_davis]: a_n_per_kn, b_n_per_kn_per_kmh,
b_n_per_mps = 230.0                       # c_n_per_kn_per_kmh2: N/kN, V in km/h
c_n_per_mps2 = 5.0

[traction]
max_effort_kn = 180.0
max_power_kw = 1500.0                     # optional
points = [{ speed_kmh = 0.0, effort_kn = 180.0 }]     # optional, the lowest of the three holds
time_constant_s = 0.4
dead_time_s = 0.1
jerk_limit_mps3 = 1.0

[electrodynamic]                          # as [traction], and
fade_start_kmh = 7.0                      # full above, none below fade_end_kmh
fade_end_kmh = 2.0

[pneumatic]
max_effort_kn = 220.0
emergency_effort_kn = 260.0
holding_effort_kn = 80.0
time_constant_s = 0.6
dead_time_s = 0.2
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from pydantic import Field

from hil.railway.errors import RailwayDataError
from hil.railway.files import FileModel, read_toml, validate
from hil.railway.line_file import Name, NotNegative, Positive, Schema, Text
from hil.railway.resistance import davis_from_kmh
from hil.railway.train import (
    DavisCoefficients,
    EffortCurve,
    ElectrodynamicBrake,
    PneumaticBrake,
    TractionDrive,
    Train,
)
from hil.railway.ttobench import load_ttobench_train

Fraction = Annotated[float, Field(gt=0.0, le=1.0)]
# Metro trains have 0.05 to 0.12; a value of 1.08 is the other convention and must not pass.
RotatingFactor = Annotated[float, Field(ge=0.0, le=0.5)]


def load_train(path: Path) -> Train:
    """Train of a file, TOML or TTOBench JSON. RailwayDataError: file, key, value and limit in one line."""
    if path.suffix == ".json":
        return load_ttobench_train(path)
    file = validate(TrainFile, read_toml(path), path)
    mass_kg = file.mass_t * 1000.0
    if (file.davis is None) == (file.specific_davis is None):
        have = "none" if file.davis is None else "both"
        raise RailwayDataError(
            f"{path}: davis: exactly one of [davis] and [specific_davis] must be there, not {have}"
        )
    try:
        train = Train(
            name=file.name,
            title=file.title,
            source=file.source,
            mass_kg=mass_kg,
            rotating_mass_factor=file.rotating_mass_factor,
            length_m=file.length_m,
            davis=_davis(file, mass_kg),
            starting_resistance_n_per_kn=file.starting_resistance_n_per_kn,
            powered_mass_fraction=file.powered_mass_fraction,
            traction=file.traction.drive(),
            electrodynamic=file.electrodynamic.brake(),
            pneumatic=file.pneumatic.brake(),
            max_acceleration_mps2=file.max_acceleration_mps2,
            max_braking_mps2=file.max_braking_mps2,
            comfort_jerk_mps3=file.comfort_jerk_mps3,
            max_speed_mps=math.inf if file.max_speed_kmh is None else file.max_speed_kmh / 3.6,
            traction_efficiency=file.traction_efficiency,
            regeneration_efficiency=file.regeneration_efficiency,
        )
    except RailwayDataError as error:
        raise RailwayDataError(f"{path}: {error}") from None
    service_n = train.service_brake_effort_n()
    # Below the fade-out the friction brake is alone; 0.1 % is for rounded numbers in the file.
    if train.pneumatic.max_effort_n < 0.999 * service_n:
        raise RailwayDataError(
            f"{path}: pneumatic.max_effort_kn: {file.pneumatic.max_effort_kn:g} must be at least "
            f"{service_n / 1e3:.1f}, the effort of max_braking_mps2 = {file.max_braking_mps2:g}"
        )
    return train


class Point(FileModel):
    """A point of an effort curve."""

    speed_kmh: NotNegative
    effort_kn: NotNegative


class DriveTable(FileModel):
    """The table `[traction]`."""

    max_effort_kn: Positive
    max_power_kw: Positive | None = None
    points: list[Point] = Field(default_factory=list)
    time_constant_s: NotNegative
    dead_time_s: NotNegative
    jerk_limit_mps3: Positive

    def curve(self) -> EffortCurve:
        """Effort curve in SI."""
        points = tuple((p.speed_kmh / 3.6, p.effort_kn * 1e3) for p in self.points)
        power_w = None if self.max_power_kw is None else self.max_power_kw * 1e3
        return EffortCurve(self.max_effort_kn * 1e3, power_w, points)

    def drive(self) -> TractionDrive:
        """Drive in SI."""
        return TractionDrive(self.curve(), self.time_constant_s, self.dead_time_s, self.jerk_limit_mps3)


class ElectrodynamicTable(DriveTable):
    """The table `[electrodynamic]`."""

    fade_start_kmh: Positive
    fade_end_kmh: NotNegative

    def brake(self) -> ElectrodynamicBrake:
        """Brake in SI."""
        return ElectrodynamicBrake(
            self.curve(),
            self.time_constant_s,
            self.dead_time_s,
            self.jerk_limit_mps3,
            self.fade_start_kmh / 3.6,
            self.fade_end_kmh / 3.6,
        )


class PneumaticTable(FileModel):
    """The table `[pneumatic]`."""

    max_effort_kn: Positive
    emergency_effort_kn: Positive
    holding_effort_kn: Positive
    time_constant_s: NotNegative
    dead_time_s: NotNegative

    def brake(self) -> PneumaticBrake:
        """Brake in SI."""
        return PneumaticBrake(
            self.max_effort_kn * 1e3,
            self.time_constant_s,
            self.dead_time_s,
            self.emergency_effort_kn * 1e3,
            self.holding_effort_kn * 1e3,
        )


class DavisTable(FileModel):
    """The table `[davis]`: N, v in m/s."""

    a_n: NotNegative
    b_n_per_mps: NotNegative
    c_n_per_mps2: NotNegative


class SpecificDavisTable(FileModel):
    """The table `[specific_davis]`: N/kN, V in km/h."""

    a_n_per_kn: NotNegative
    b_n_per_kn_per_kmh: NotNegative
    c_n_per_kn_per_kmh2: NotNegative


class TrainFile(FileModel):
    """A train file."""

    schema_: Annotated[Schema, Field(alias="schema")]
    name: Name
    title: Text
    source: Text
    mass_t: Positive
    rotating_mass_factor: RotatingFactor = 0.0
    length_m: Positive
    powered_mass_fraction: Fraction = 1.0
    starting_resistance_n_per_kn: NotNegative = 0.0
    max_acceleration_mps2: Positive
    max_braking_mps2: Positive
    comfort_jerk_mps3: Positive
    max_speed_kmh: Positive | None = None
    traction_efficiency: Fraction = 1.0
    regeneration_efficiency: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    davis: DavisTable | None = None
    specific_davis: SpecificDavisTable | None = None
    traction: DriveTable
    electrodynamic: ElectrodynamicTable
    pneumatic: PneumaticTable


def _davis(file: TrainFile, mass_kg: float) -> DavisCoefficients:
    if file.specific_davis is not None:
        s = file.specific_davis
        return DavisCoefficients(
            *davis_from_kmh(s.a_n_per_kn, s.b_n_per_kn_per_kmh, s.c_n_per_kn_per_kmh2, mass_kg)
        )
    d = file.davis
    if d is None:
        raise RailwayDataError("davis: is missing")
    return DavisCoefficients(d.a_n, d.b_n_per_mps, d.c_n_per_mps2)
