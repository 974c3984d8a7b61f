"""From a journey and its configuration to the plan, and to the table that the unit looks it up in."""

from __future__ import annotations

from dataclasses import dataclass

from controller.config import ControllerConfig, FeedForwardConfig
from controller.laws import Drive
from controller.profile import SpeedProfile
from controller.profile.comfort import Comfort
from controller.profile.optimal import OptimalPlanner
from controller.profile.plain import plain_sharp
from controller.profile.reference import Columns, Delay, ReferenceTable, columns_of
from hil.railway import Journey, Train

CLOCK_LEADS_S = 4.0
"""How long the plan's own clock leads a train that departs."""


@dataclass(frozen=True)
class Plan:
    """A plan as it was made (`sharp`) and as it is driven (`profile`), both on one clock; see `Comfort`."""

    sharp: SpeedProfile
    profile: SpeedProfile


def plan(journey: Journey, config: ControllerConfig) -> Plan:
    """The plan that arrives by the timetable, the release of the holding brake included; ProfileError."""
    comfort, dwell_s = Comfort.of(journey.train, config.profile), config.hold.release_s
    if config.profile.planner == "plain":
        sharp = plain_sharp(journey, config.profile, dwell_s=dwell_s)
    else:
        planner = OptimalPlanner(journey, config.profile)
        sharp = planner.plan_within(journey.time_s, dwell_s + comfort.delay_s)
    return Plan(sharp, comfort.smoothed(sharp))


def drive_of(train: Train) -> Drive:
    """What a law may know of the train's drive and brakes."""
    traction, friction, motors = train.traction, train.pneumatic, train.electrodynamic
    return Drive(
        traction.dead_time_s,
        traction.time_constant_s,
        friction.dead_time_s,
        friction.time_constant_s,
        motors.fade_start_mps,
        motors.fade_end_mps,
    )


def reference_columns(
    profile: SpeedProfile, train: Train, config: FeedForwardConfig, *, start_s: float = CLOCK_LEADS_S
) -> Columns:
    """The profile as the unit looks it up; dead times and lags are the train's where not configured."""
    brake, motors = train.pneumatic, train.electrodynamic
    friction = _delay(config.friction_lead_s, config.friction_lag_s, brake.dead_time_s, brake.time_constant_s)
    return columns_of(
        profile,
        drive=drive_delay(train, config),
        friction=friction,
        friction_share=lambda speed: 1.0 - motors.fade(speed),
        start_s=start_s,
    )


def reference_table(profile: SpeedProfile, train: Train, config: FeedForwardConfig) -> ReferenceTable:
    """The table over `reference_columns`."""
    return ReferenceTable.of_columns(reference_columns(profile, train, config))


def drive_delay(train: Train, config: FeedForwardConfig) -> Delay:
    """What lies between a demand and its effect while the motors work."""
    return _delay(config.lead_s, config.lag_s, train.traction.dead_time_s, train.traction.time_constant_s)


def _delay(lead_s: float | None, lag_s: float | None, train_dead_s: float, train_lag_s: float) -> Delay:
    lead = train_dead_s + train_lag_s if lead_s is None else lead_s
    lag = min(train_lag_s if lag_s is None else lag_s, lead)
    return Delay(lead - lag, lag)
