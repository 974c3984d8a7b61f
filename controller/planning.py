"""From a journey and its configuration to the profile, and to the table that the unit looks it up in."""

from __future__ import annotations

from controller.config import ControllerConfig, FeedForwardConfig
from controller.profile import SpeedProfile
from controller.profile.plain import plain_profile
from controller.profile.reference import Delay, ReferenceTable
from hil.railway import Journey, Train


def plan(journey: Journey, config: ControllerConfig) -> SpeedProfile:
    """The plain plan that arrives by the timetable, the release of the holding brake included."""
    return plain_profile(journey, config.profile, dwell_s=config.hold.release_s)


def reference_table(profile: SpeedProfile, train: Train, config: FeedForwardConfig) -> ReferenceTable:
    """The profile as the unit looks it up; dead times and lags are the train's where not configured."""
    drive = _delay(config.lead_s, config.lag_s, train.traction.dead_time_s, train.traction.time_constant_s)
    brake = train.pneumatic
    friction = _delay(config.friction_lead_s, config.friction_lag_s, brake.dead_time_s, brake.time_constant_s)
    motors = train.electrodynamic
    return ReferenceTable(
        profile, drive=drive, friction=friction, friction_share=lambda speed: 1.0 - motors.fade(speed)
    )


def _delay(lead_s: float | None, lag_s: float | None, train_dead_s: float, train_lag_s: float) -> Delay:
    lead = train_dead_s + train_lag_s if lead_s is None else lead_s
    lag = min(train_lag_s if lag_s is None else lag_s, lead)
    return Delay(lead - lag, lag)
