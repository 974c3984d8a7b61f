"""The table `[controller]` of a scenario: which law, how fast, which plan, what supervision tolerates.

Every key is optional; unknown keys, wrong types, nan and inf are errors of one line with file, key,
value and limit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from controller.laws.tables import (
    FsmcConfig,
    FsmcEsoConfig,
    FuzzyDConfig,
    FuzzyPidConfig,
    PidConfig,
    SmcConfig,
    SpeedTConfig,
)
from hil.railway import Train, scenario_table
from hil.railway.files import FileModel, validate

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Share = Annotated[float, Field(gt=0.0, le=1.0)]


class ProfileConfig(FileModel):
    """The plan: how the train should run, before any control."""

    planner: Literal["optimal", "plain"] = "optimal"
    """Least energy, or the plain plan: accelerate, cruise, coast, brake. Re-planning is always optimal."""
    acceleration_mps2: Annotated[float, Field(gt=0.05, le=2.0)] | None = None
    """Default: 0.85 of what the train reaches (`max_acceleration_mps2`)."""
    braking_mps2: Annotated[float, Field(gt=0.05, le=2.0)] | None = None
    """Default: 0.62 of full service braking: 0.8 of the brake on 1.2 of the mass leaves 0.67."""
    jerk_mps3: Annotated[float, Field(gt=0.1, le=2.0)] | None = None
    """Default: the train's `comfort_jerk_mps3`."""
    smoothing_s: Annotated[float, Field(ge=0.0, le=5.0)] = 0.8
    """The jerk itself sets in and ends over this time, so that a drive with a lag can follow exactly."""
    stop_braking_mps2: Annotated[float, Field(gt=0.02, le=0.5)] = 0.12
    """Deceleration of the last moment: what the passengers feel when the train comes to a stand."""
    stop_braking_s: Annotated[float, Field(ge=0.0, le=10.0)] = 1.5
    """How long the plan keeps it."""
    speed_margin_mps: Annotated[float, Field(ge=0.0, le=5.0)] = 0.05
    """Distance of the plan from every speed limit."""
    traction_share: Share = 0.85
    brake_share: Share = 0.8
    """Shares of the nominal effort that the plan may use; the rest is the law's."""
    coasting_share: Annotated[float, Field(gt=0.1, le=1.0)] = 0.9
    """With time to spare the plain plan coasts from the cruising speed down to this share of it."""


class ReplanningConfig(FileModel):
    """When the plan is made anew while the train is on its way; see :mod:`controller.replanning`."""

    enabled: bool = True
    threshold_s: Annotated[float, Field(ge=0.2)] = 2.0
    """So late, or early, against its plan, the unit asks for a new one. A speed restriction asks at once."""
    departure_s: NotNegative = 1.0
    """Departure is due so long after the unit is first READY; the timetable's clock starts then."""
    take_after_s: Annotated[float, Field(ge=0.05, le=2.0)] = 0.3
    """A new plan is taken so long after it was asked for: in lockstep exactly then, else not before."""
    interval_s: NotNegative = 10.0
    """Least time between two new plans that are asked for because of the timetable."""


class FeedForwardConfig(FileModel):
    """What the demand contains before any feedback."""

    lead_s: Annotated[float, Field(ge=0.0, le=3.0)] | None = None
    """How far a demand comes ahead of its effect. Default: dead time plus lag of the traction drive."""
    lag_s: Annotated[float, Field(ge=0.0, le=3.0)] | None = None
    """The part of it that is a first-order lag. Default: that of the traction drive, at most `lead_s`."""
    friction_lead_s: Annotated[float, Field(ge=0.0, le=3.0)] | None = None
    friction_lag_s: Annotated[float, Field(ge=0.0, le=3.0)] | None = None
    """The same for the friction brake, which takes over where the motor brake fades out."""
    acceleration: bool = True
    """Whether the laws see the plan's acceleration at all."""
    resistance: bool = True
    """Whether Davis, gradient and curve resistance are added behind the law."""


class SupervisionConfig(FileModel):
    """Limits of the supervision; see the table in :mod:`controller.supervision`."""

    overspeed_warning_mps: Positive = 0.4
    overspeed_brake_mps: Positive = 0.8
    service_brake_share: Share = 0.8
    """Share of full service braking that an override commands."""
    odometry_grace_s: NotNegative = 1.0
    """Service brake at once, emergency brake after this time without odometry."""
    recovery_s: NotNegative = 0.5
    """How long inputs must be good again before the law gets the train back."""
    plausible_acceleration_mps2: Positive = 6.0
    """A speed that changes faster without slip or slide is not believed."""
    overrun_m: Positive = 1.0
    roll_back_m: Positive = 0.3
    roll_back_mps: Positive = 0.15
    balise_tolerance_m: Positive = 15.0
    deadline_misses: Annotated[int, Field(ge=1)] = 10
    """So many own missed cycles at once are too many; the count decays by as many in a second."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.overspeed_brake_mps > self.overspeed_warning_mps:
            raise ValueError(
                f"overspeed_brake_mps {self.overspeed_brake_mps:g} must be greater than "
                f"overspeed_warning_mps = {self.overspeed_warning_mps:g}"
            )
        return self


class HoldConfig(FileModel):
    """Standstill: where the train has arrived, when the holding brake comes and goes."""

    window_m: Positive = 0.1
    """Standing closer than this before the stop point, or past it by less than `overrun_m`: arrived."""
    speed_mps: NotNegative = 0.006
    """Below this speed, within the window, the holding brake is applied; two steps of 0.01 km/h."""
    release_s: Annotated[float, Field(ge=0.0, le=10.0)] = 1.2
    """Time for the holding brake to release at departure; the plan starts after it."""


class ControllerConfig(FileModel):
    """The whole table `[controller]`."""

    law: Literal["fuzzy_d", "pid", "speedt", "fuzzy_pid", "smc", "fsmc", "fsmc_eso"] = "fuzzy_d"
    period_s: Annotated[float, Field(gt=0.0, le=0.1)] = 0.01
    profile: ProfileConfig = ProfileConfig()
    replanning: ReplanningConfig = ReplanningConfig()
    feed_forward: FeedForwardConfig = FeedForwardConfig()
    pid: PidConfig = PidConfig()
    speedt: SpeedTConfig = SpeedTConfig()
    fuzzy_d: FuzzyDConfig = FuzzyDConfig()
    fuzzy_pid: FuzzyPidConfig = FuzzyPidConfig()
    smc: SmcConfig = SmcConfig()
    fsmc: FsmcConfig = FsmcConfig()
    fsmc_eso: FsmcEsoConfig = FsmcEsoConfig()
    supervision: SupervisionConfig = SupervisionConfig()
    hold: HoldConfig = HoldConfig()

    @classmethod
    def load(cls, scenario: Path) -> ControllerConfig:
        """Table `[controller]` of a scenario; RailwayDataError: file, key, value, limit in one line."""
        return validate(cls, scenario_table(scenario, "controller"), scenario, "controller")

    def law_picture(self, train: Train) -> dict[str, object]:
        """The law's inside as plain values, for whoever draws it: :func:`controller.picture.law_picture`."""
        from controller.picture import law_picture  # it needs this module
        from controller.planning import drive_of

        return law_picture(self, drive_of(train))
