"""Fuzzy sliding mode with an extended-state observer: the FSMC paper's law as a drive on a bus needs it.

    s = v^ - vd;   ds = f^ - R + L - dvd/dt, filtered
    u = (dvd/dt ahead - K uf(s, ds) + R - (L + t_a dL/dt)) / b - R

The observer (:mod:`controller.laws.observer`) knows the drive's dead time and lag. It takes away the
disturbance without loop gain and supplies s and its rate without noise: nothing chatters, and no quantised
speed is differenced. The rule base is that of the FSMC paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from controller.fuzzy.bases import fsmc_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.laws import Drive, Measurement, Reference, clamp, speed_error
from controller.laws.observer import ExtendedStateObserver


@dataclass(frozen=True)
class FsmcEsoParameters:
    """What is None follows from the drive's delay T = dead time + lag: slower drives, slower law."""

    gain_mps2: float = 1.6
    """K; the output of the rules is -1 .. 1."""
    half_range_s_mps: float | None = None
    """Default: 0.64 m/s2 T; the gain on s is then K / (2 half range) = 1.25 / T."""
    half_range_rate_mps2: float = 2.8
    bandwidth_per_s: float | None = None
    """w of the observer. Default: 1.25 / T."""
    rate_filter_s: float | None = None
    """Of ds. Default: 0.5 T."""
    smoothing_s: float | None = None
    """Of all that is added to the plan's acceleration: takes the steps of the speed out. Default: 0.16 T."""
    disturbance_lead_s: float = 0.05
    """t_a: how far ahead the disturbance is taken away."""
    learning_s: float = 1.5
    """Time constant with which what the observer learns under effort is taken for a factor; 0: never."""
    dead_time_s: float | None = None
    """Of the drive as the observer models it. Default: that of the train's traction."""
    lag_s: float | None = None
    """The same for its first-order lag."""
    unmodelled_limit_mps2: float = 0.6
    """Most that the observer may blame on mass, gradient, wind and brake."""
    speed_resolution_mps: float = 0.01 / 3.6
    """Step of the measured speed, 0.01 km/h on the bus; a quarter of it is no news to the observer."""
    reported_effort: bool = True
    """Observe with the effort that drive and brakes report, where they do; the model bridges the cycle."""
    preview: bool = True
    """Take the plan's acceleration ahead of the drive's delay."""

    def tuning(self, drive: Drive) -> Tuning:
        """The same with nothing left open, for this drive."""
        dead_time_s = drive.dead_time_s if self.dead_time_s is None else self.dead_time_s
        lag_s = drive.lag_s if self.lag_s is None else self.lag_s
        delay_s = max(dead_time_s + lag_s, LEAST_DELAY_S)
        half_range, bandwidth, rate_filter = self.half_range_s_mps, self.bandwidth_per_s, self.rate_filter_s
        return Tuning(
            drive._replace(dead_time_s=dead_time_s, lag_s=lag_s),
            0.64 * delay_s if half_range is None else half_range,
            1.25 / delay_s if bandwidth is None else bandwidth,
            0.5 * delay_s if rate_filter is None else rate_filter,
            0.16 * delay_s if self.smoothing_s is None else self.smoothing_s,
        )


class Tuning(NamedTuple):
    """What follows from the drive, as it is used."""

    drive: Drive
    half_range_s_mps: float
    bandwidth_per_s: float
    rate_filter_s: float
    smoothing_s: float

    def slowed(self, speed_mps: float) -> float:
        """Factor of the gain on s while braking at this speed: the friction brake is slower."""
        drive = self.drive
        share = drive.friction_share(speed_mps)
        if share == 0.0:
            return 1.0
        motors_s = max(drive.dead_time_s + drive.lag_s, LEAST_DELAY_S)
        friction_s = max(drive.friction_dead_time_s + drive.friction_lag_s, motors_s)
        return motors_s / (motors_s + share * (friction_s - motors_s))


LEAST_DELAY_S = 0.1
"""A drive without any delay does not make the law infinitely fast: the bus alone takes two cycles."""

PAPER = FsmcEsoParameters(
    gain_mps2=1.607,
    half_range_s_mps=0.161,
    half_range_rate_mps2=9.0,
    bandwidth_per_s=2.86,
    rate_filter_s=0.237,
    smoothing_s=0.0,
    disturbance_lead_s=0.0045,
    dead_time_s=0.01,
    lag_s=0.2,
    learning_s=0.0,
    speed_resolution_mps=0.0,
    reported_effort=False,
)
"""Tuned for the FSMC paper's train and reference with a drive of 0.2 s lag behind a 100 Hz bus.

The paper has no observer. Differential evolution over six cases of mass, lag and disturbance, the error
bounded by chatter (its plan's acceleration is taken 0.347 s ahead: the study's own business).
"""


DRIVE = Drive()


class FsmcEso:
    """See the module docstring. One sample time per life: `reset` before another `dt_s`."""

    probe_names = (
        ("sliding_surface_mps", "m/s"),
        ("surface_rate_mps2", "m/s^2"),
        ("fuzzy_output", "1"),
        ("feed_forward_mps2", "m/s^2"),
        ("unmodelled_mps2", "m/s^2"),
        ("estimated_speed_mps", "m/s"),
        ("rules_clipped", "1"),
    )

    def __init__(self, parameters: FsmcEsoParameters, drive: Drive = DRIVE) -> None:
        self.parameters = parameters
        self.tuning = parameters.tuning(drive)
        self._fuzzy = CompiledRuleBase(
            fsmc_rules(self.tuning.half_range_s_mps, parameters.half_range_rate_mps2)
        )
        self._observer: ExtendedStateObserver | None = None
        self.reset()

    def reset(self) -> None:
        """Forget the train: the observer starts anew with the next measurement."""
        self._observer = None
        self._fuzzy.reset()
        self._s = 0.0
        self._s_rate = 0.0
        self._output = 0.0
        self._correction = 0.0
        self._feed_forward = 0.0

    def step(self, reference: Reference, measurement: Measurement, dt_s: float) -> float:
        """Acceleration demand [m/s2]; ValueError on a non-finite input."""
        p = self.parameters
        speed_error(reference, measurement)
        resistance = measurement.resistance_mps2
        self._feed_forward = reference.preview_mps2 if p.preview else reference.acceleration_mps2
        observer = self._observer
        if observer is None:
            observer = self._observer = ExtendedStateObserver(
                drive=self.tuning.drive,
                bandwidth_per_s=self.tuning.bandwidth_per_s,
                learning_s=p.learning_s,
                limit_mps2=p.unmodelled_limit_mps2,
                resolution_mps=p.speed_resolution_mps,
                dt_s=dt_s,
            )
        tuning = self.tuning
        slower = 1.0
        if reference.acceleration_mps2 < 0.0:
            slower = tuning.slowed(measurement.speed_mps)
        observer.correct(measurement.speed_mps, reference.acceleration_mps2 + resistance)
        if p.reported_effort and measurement.effort_mps2 is not None:
            effort = measurement.effort_mps2
            # A brake holds a standing train against what pulls at it; it does not push it back.
            observer.report(effort if measurement.speed_mps != 0.0 else max(effort, resistance))
        self._s = slower * (observer.speed_mps - reference.speed_mps)
        rate = observer.acceleration_mps2(resistance) - reference.acceleration_mps2
        self._s_rate += dt_s / (tuning.rate_filter_s + dt_s) * (rate - self._s_rate)
        self._output = self._fuzzy(self._s, self._s_rate)
        wanted = self._feed_forward - p.gain_mps2 * self._output
        needed = observer.force_mps2(wanted, resistance, p.disturbance_lead_s) - resistance
        correction = needed - self._feed_forward
        self._correction += dt_s / (tuning.smoothing_s + dt_s) * (correction - self._correction)
        free = self._feed_forward + self._correction
        demand = clamp(free, measurement.lowest_mps2, measurement.highest_mps2)
        observer.predict(demand + resistance, resistance)
        return demand

    def internals(self) -> tuple[float, ...]:
        """s, its rate, output of the rules, planned acceleration, L, estimated speed, clipped or not."""
        observer = self._observer
        unmodelled, speed = (0.0, 0.0) if observer is None else (observer.unmodelled_mps2, observer.speed_mps)
        clipped = float(self._fuzzy.is_clipping)
        return self._s, self._s_rate, self._output, self._feed_forward, unmodelled, speed, clipped
