"""Supervision: what overrides the law, for how long, and how.

State (number of the bus contract), worst first; the reported state is the worst that is active.

| state                  | while                                         | reaction            | ends        |
|------------------------|-----------------------------------------------|---------------------|-------------|
| EMERGENCY_STOP_ORDERED | the ATP orders it                             | emergency brake     | see below   |
| BUS_LOST               | odometry, traction, brake and ATP all silent  | emergency brake     | never       |
| BRAKE_LOST             | BCU silent or faulty                          | emergency brake     | never       |
| ROLL_BACK              | moving backward by distance or speed          | emergency brake     | never       |
| STOP_OVERRUN           | `overrun_m` past the stop                     | service brake       | never       |
| ODOMETRY_LOST          | ODO silent                                    | service brake (*)   | recovered   |
| ODOMETRY_INVALID       | flagged, E2E latch, implausible (**)          | service brake (*)   | recovered   |
| PERMISSION_LOST        | ATP silent, departure withdrawn, doors open   | service brake       | recovered   |
| OVERSPEED_BRAKE        | above permitted + `overspeed_brake_mps`       | service brake       | permitted   |
| DEADLINES_MISSED       | too many own cycles missed                    | service brake       | decayed     |
| TRACTION_LOST          | TCU silent, cut or in fault; BCU brakes alone | no traction         | recovered   |
| OVERSPEED_WARNING      | above permitted + `overspeed_warning_mps`     | no traction         | permitted   |
| BALISE_MISSED          | passed a balise without its telegram          | none, reported      | next read   |
| WAITING_FOR_INPUTS     | not driving, and an input is missing          | holding brake       | all valid   |

(*) After `odometry_grace_s` without good odometry: emergency brake, for the rest of the run.
(**) A speed that changes faster than `plausible_acceleration_mps2`; a position that moves farther than the
speed explains, by more than `balise_tolerance_m`; a balise telegram from as far away. An overrun that such a
position claims does not latch.
recovered: good for `recovery_s`. permitted: speed at or below the permitted one again.

Braking beats traction: reactions only ever lower the demand. Emergency brake reactions latch: only the
ATP's own order can be withdrawn, and only at standstill; every other one stays for the rest of the run.
Emergency stop, roll-back, overrun and odometry are watched in every mode, the others while the train is
driven: at the platform doors open and units may go silent, and the holding brake is applied anyway.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from controller.config import SupervisionConfig


class Supervision(IntEnum):
    """State of the supervision; numbers equal the value table of `ATO_Status.Supervision`."""

    NORMAL = 0
    WAITING_FOR_INPUTS = 1
    OVERSPEED_WARNING = 2
    OVERSPEED_BRAKE = 3
    ODOMETRY_LOST = 4
    ODOMETRY_INVALID = 5
    PERMISSION_LOST = 6
    TRACTION_LOST = 7
    BRAKE_LOST = 8
    DEADLINES_MISSED = 9
    STOP_OVERRUN = 10
    ROLL_BACK = 11
    EMERGENCY_STOP_ORDERED = 12
    BALISE_MISSED = 13
    BUS_LOST = 14


class Reaction(IntEnum):
    """What an active state does to the law's demand; a higher one includes the lower."""

    NONE = 0
    NO_TRACTION = 1
    SERVICE_BRAKE = 2
    EMERGENCY_BRAKE = 3


@dataclass(slots=True)
class Observation:
    """What supervision looks at; refilled in every cycle. The default is a healthy train that stands."""

    driving: bool = True
    """The mode is one in which the train may move under this unit's command."""
    odometry_alive: bool = True
    odometry_valid: bool = True
    traction_alive: bool = True
    traction_able: bool = True
    brake_alive: bool = True
    permission_alive: bool = True
    departure_authorised: bool = True
    doors_closed: bool = True
    emergency_stop: bool = False
    standstill: bool = True
    slipping: bool = False
    """Slip or slide is flagged: the speed may jump."""
    odometry_fresh: bool = True
    speed_mps: float = 0.0
    position_m: float = 0.0
    permitted_mps: float = 100.0
    distance_to_stop_m: float = 1000.0
    balise_missed: bool = False
    balise_far: bool = False
    """A balise telegram came from where the train cannot be."""
    deadline_misses: int = 0
    """Total since the start."""

    @property
    def complete(self) -> bool:
        """Every input is there and good."""
        return (
            self.odometry_alive
            and self.odometry_valid
            and self.traction_alive
            and self.brake_alive
            and self.permission_alive
        )


class Supervisor:
    """Judges one observation per cycle. `state` and `reaction` are the result of the last `update`."""

    def __init__(self, config: SupervisionConfig, *, period_s: float) -> None:
        self._config = config
        self._period_s = period_s
        self._recovery_cycles = max(1, round(config.recovery_s / period_s))
        self._grace_cycles = max(1, round(config.odometry_grace_s / period_s))
        self.state = Supervision.WAITING_FOR_INPUTS
        self.reaction = Reaction.NONE
        self._started = False
        self._latched: Supervision | None = None
        self._odometry_cause = Supervision.ODOMETRY_LOST
        # Cycles until a recovering cause is over; 0: not active.
        self._odometry_hold = 0
        self._permission_hold = 0
        self._traction_hold = 0
        self._odometry_bad_cycles = 0
        self._overspeed = Reaction.NONE
        self._overrun = False
        self._last_speed_mps: float | None = None
        self._last_position_m = 0.0
        self._cycles_since_motion = 0
        self._misses_at_motion = 0
        self._furthest_m: float | None = None
        self._misses = 0
        self._miss_level = 0.0
        self._misses_tripped = False

    def update(self, seen: Observation) -> None:
        """Judge one cycle."""
        if not self._started:
            if not seen.complete and not seen.emergency_stop:
                self.state = Supervision.WAITING_FOR_INPUTS
                self.reaction = Reaction.NONE
                self._misses = seen.deadline_misses
                return
            self._started = True
        self._update_odometry(seen)
        self._update_emergencies(seen)
        past_stop = seen.distance_to_stop_m < -self._config.overrun_m
        if past_stop and seen.odometry_valid and not self._odometry_hold:
            self._overrun = True
        if seen.driving:
            self._update_driving(seen)
        else:
            self._permission_hold = self._traction_hold = 0
            self._overspeed = Reaction.NONE
            self._misses, self._miss_level, self._misses_tripped = seen.deadline_misses, 0.0, False
        self.state, self.reaction = self._worst(seen)

    def _worst(self, seen: Observation) -> tuple[Supervision, Reaction]:
        if self._latched is not None:
            return self._latched, Reaction.EMERGENCY_BRAKE
        if self._overrun:
            return Supervision.STOP_OVERRUN, Reaction.SERVICE_BRAKE
        if self._odometry_hold:
            return self._odometry_cause, Reaction.SERVICE_BRAKE
        if self._permission_hold:
            return Supervision.PERMISSION_LOST, Reaction.SERVICE_BRAKE
        if self._overspeed is Reaction.SERVICE_BRAKE:
            return Supervision.OVERSPEED_BRAKE, Reaction.SERVICE_BRAKE
        if self._misses_tripped:
            return Supervision.DEADLINES_MISSED, Reaction.SERVICE_BRAKE
        if self._traction_hold:
            return Supervision.TRACTION_LOST, Reaction.NO_TRACTION
        if self._overspeed is Reaction.NO_TRACTION:
            return Supervision.OVERSPEED_WARNING, Reaction.NO_TRACTION
        if not (seen.driving or seen.complete):
            return Supervision.WAITING_FOR_INPUTS, Reaction.NONE
        if seen.balise_missed:
            return Supervision.BALISE_MISSED, Reaction.NONE
        return Supervision.NORMAL, Reaction.NONE

    def _update_emergencies(self, seen: Observation) -> None:
        latched = self._latched
        if seen.emergency_stop:
            self._latched = latched if latched not in (None, _ORDERED) else _ORDERED
            return
        if latched is _ORDERED and seen.standstill and seen.odometry_alive and seen.odometry_valid:
            self._latched = latched = None
        if latched not in (None, _ORDERED):
            return
        cause: Supervision | None = None
        if seen.driving and not seen.brake_alive:
            silent = not (seen.odometry_alive or seen.traction_alive or seen.permission_alive)
            cause = Supervision.BUS_LOST if silent else Supervision.BRAKE_LOST
        elif seen.driving and self._odometry_bad_cycles > self._grace_cycles:
            cause = self._odometry_cause
        elif self._rolls_back(seen):
            cause = Supervision.ROLL_BACK
        if cause is not None:
            self._latched = cause

    def _rolls_back(self, seen: Observation) -> bool:
        if not seen.odometry_valid:
            return False
        if self._furthest_m is None or seen.position_m > self._furthest_m or seen.speed_mps >= 0.0:
            # A balise may also correct the position backward while the train runs forward.
            self._furthest_m = seen.position_m
            return False
        back = self._furthest_m - seen.position_m
        return back > self._config.roll_back_m or seen.speed_mps < -self._config.roll_back_mps

    def _update_odometry(self, seen: Observation) -> None:
        self._cycles_since_motion += 1
        good = seen.odometry_alive and seen.odometry_valid and self._plausible(seen)
        if good:
            self._odometry_hold = max(0, self._odometry_hold - 1)
            if not self._odometry_hold:
                self._odometry_bad_cycles = 0
            return
        self._odometry_cause = (
            Supervision.ODOMETRY_INVALID if seen.odometry_alive else Supervision.ODOMETRY_LOST
        )
        self._odometry_hold = self._recovery_cycles
        self._odometry_bad_cycles += 1

    def _plausible(self, seen: Observation) -> bool:
        """Whether speed and position can follow from the last ones, own missed cycles counted in."""
        if not seen.odometry_fresh:
            return not seen.balise_far
        config = self._config
        missed = max(0, seen.deadline_misses - self._misses_at_motion)
        elapsed_s = (self._cycles_since_motion + missed) * self._period_s
        before_mps, self._last_speed_mps = self._last_speed_mps, seen.speed_mps
        before_m, self._last_position_m = self._last_position_m, seen.position_m
        self._cycles_since_motion, self._misses_at_motion = 0, seen.deadline_misses
        if seen.balise_far:
            return False
        if before_mps is None:
            return True
        fastest = max(abs(before_mps), abs(seen.speed_mps))
        if abs(seen.position_m - before_m) > fastest * elapsed_s + config.balise_tolerance_m:
            return False
        allowed = config.plausible_acceleration_mps2 * elapsed_s + SPEED_NOISE_MPS
        return seen.slipping or abs(seen.speed_mps - before_mps) <= allowed

    def _update_driving(self, seen: Observation) -> None:
        config = self._config
        if not (seen.permission_alive and seen.departure_authorised and seen.doors_closed):
            self._permission_hold = self._recovery_cycles
        elif self._permission_hold:
            self._permission_hold -= 1
        if not (seen.traction_alive and seen.traction_able):
            self._traction_hold = self._recovery_cycles
        elif self._traction_hold:
            self._traction_hold -= 1

        over = seen.speed_mps - seen.permitted_mps
        if over > config.overspeed_brake_mps:
            self._overspeed = Reaction.SERVICE_BRAKE
        elif over > config.overspeed_warning_mps:
            self._overspeed = max(self._overspeed, Reaction.NO_TRACTION)
        elif over <= 0.0:
            self._overspeed = Reaction.NONE

        new = seen.deadline_misses - self._misses
        self._misses = seen.deadline_misses
        limit = config.deadline_misses
        decayed = max(0.0, self._miss_level - limit * self._period_s)
        self._miss_level = min(2.0 * limit, decayed + new)
        if self._miss_level >= limit:
            self._misses_tripped = True
        elif self._miss_level == 0.0:
            self._misses_tripped = False


SPEED_NOISE_MPS = 0.15
"""Jump of the measured speed that is noise and quantisation, whatever the time between two values."""

_ORDERED = Supervision.EMERGENCY_STOP_ORDERED
