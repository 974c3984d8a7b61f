"""The table `[plant]` of a scenario: how the true train, its sensors and its protection differ from nominal.

Everything has a default; a scenario without the table gets a train that is exactly its data file, an
odometer that is right, balises read to 2 cm, and a protection that lets the train go a second after READY.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from hil.railway import scenario_table
from hil.railway.files import FileModel, validate

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Factor = Annotated[float, Field(gt=0, le=3)]
MAX_RESTRICTION_M = 32_767.0
"""What ATP_Restriction.Length can say."""


class TrainTable(FileModel):
    """`[plant.train]`: the true train as factors of the nominal one, which the controller knows."""

    mass_factor: Factor = 1.0
    traction_factor: Factor = 1.0  # effort that arrives, of what the drive believes it gives
    brake_factor: Factor = 1.0  # the same for both brakes
    friction_brake_factor: Factor = 1.0  # of the friction brake, on top of brake_factor
    davis_factor: Annotated[float, Field(ge=0, le=3)] = 1.0
    gradient_factor: Annotated[float, Field(ge=0, le=3)] = 1.0  # true slope over that of the line's file
    time_constant_factor: Factor = 1.0  # of traction and electrodynamic brake
    friction_time_constant_factor: Factor = 1.0  # of the friction brake
    dead_time_factor: Annotated[float, Field(ge=0, le=3)] = 1.0  # of drive and friction brake
    adhesion: Annotated[float, Field(gt=0, le=2)] = 1.0  # of dry rail (Curtius/Kniffler)


class DisturbanceTable(FileModel):
    """`[plant.disturbance]`: an acceleration that nobody knows of, A sin(w t + phase).

    `t` is the plant's own time since the start of the run. It acts as a force on the effective mass, as a
    gradient does: what holds a standing train holds it against this too. Positive pushes forward.
    """

    amplitude_mps2: Annotated[float, Field(ge=0, le=1)] = 0.0
    angular_frequency_radps: Annotated[float, Field(ge=0, le=100)] = 1.0
    phase_rad: Annotated[float, Field(ge=-10, le=10)] = 0.0


class OdometryTable(FileModel):
    """`[plant.odometry]`: errors of the odometer and the balise reader."""

    wheel_diameter_error: Annotated[float, Field(ge=-0.1, le=0.1)] = (
        0.0  # relative; the train's is unknown to it
    )
    speed_noise_mps: Annotated[float, Field(ge=0, le=1)] = 0.0
    balise_error_m: Annotated[float, Field(ge=0, le=5)] = 0.02
    missed_balise_probability: Annotated[float, Field(ge=0, le=1)] = 0.0


class RestrictionTable(FileModel):
    """`[[plant.atp.restrictions]]`: a temporary speed restriction that comes up during the run."""

    start_m: float
    end_m: float
    limit_kmh: Annotated[float, Field(ge=5, le=255)]
    from_s: NotNegative = 0.0  # when it is announced, and holds, after the start

    @field_validator("end_m")
    @classmethod
    def _beyond_the_start(cls, end_m: float, info: ValidationInfo) -> float:
        start_m = info.data.get("start_m")
        if start_m is not None and not start_m < end_m <= start_m + MAX_RESTRICTION_M:
            raise ValueError(
                f"{end_m:g} must be greater than start_m = {start_m:g}, by at most {MAX_RESTRICTION_M:g} m"
            )
        return end_m


class AtpTable(FileModel):
    """`[plant.atp]`: doors, departure, and when the protection orders an emergency stop."""

    doors_close_s: NotNegative = 0.5  # after the start
    departure_delay_s: NotNegative = 1.0  # after the first READY of the ATO
    overlap_m: NotNegative = 10.0  # the braking curve to the stop ends this far beyond it
    braking_factor: Annotated[float, Field(gt=0, le=1)] = 0.95  # of the full service braking
    emergency_margin_mps: NotNegative = 1.0  # above the permitted speed
    restrictions: Annotated[tuple[RestrictionTable, ...], Field(max_length=8, strict=False)] = ()


class CommandTable(FileModel):
    """`[plant.command]`: what the units do when ATO_Command is lost (see `plant_sim.command`)."""

    lost_brake: Literal["service", "emergency"] = "service"
    recovery: Literal["commands", "standstill"] = "commands"
    recovery_commands: Annotated[int, Field(ge=1)] = 20


class PlantConfig(FileModel):
    """The table `[plant]`."""

    period_s: Annotated[float, Field(ge=0.001, le=0.1)] = 0.01
    substep_s: Annotated[float, Field(ge=0.0001, le=0.01, validate_default=True)] = 0.001
    point_mass: bool = False  # gradients, curves and limits act on the train's front alone
    train: TrainTable = TrainTable()
    disturbance: DisturbanceTable = DisturbanceTable()
    odometry: OdometryTable = OdometryTable()
    atp: AtpTable = AtpTable()
    command: CommandTable = CommandTable()

    @property
    def substeps(self) -> int:
        """Integration steps in one cycle."""
        return round(self.period_s / self.substep_s)

    @property
    def period_ns(self) -> int:
        """Length of a cycle [ns]."""
        return round(self.period_s * 1e9)

    @classmethod
    def load(cls, scenario: Path) -> PlantConfig:
        """Configuration of a scenario file; RailwayDataError names file, key, value and limit."""
        return validate(cls, scenario_table(scenario, "plant"), scenario, "plant")

    @field_validator("substep_s")
    @classmethod
    def _divides_the_period(cls, substep_s: float, info: ValidationInfo) -> float:
        period_s = info.data.get("period_s")  # missing if it was wrong itself
        if period_s is not None:
            steps = round(period_s / substep_s)
            if steps < 1 or abs(steps * substep_s - period_s) > 1e-12:
                raise ValueError(f"{substep_s:g} must divide period_s = {period_s:g}")
        return substep_s
