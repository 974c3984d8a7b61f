"""ATP, the train protection: how fast the train may be, when it may leave, when it must stop at once.

Permitted speed: the lowest of the limits under the train and of the braking curves
sqrt(v_t^2 + 2 b d) to every lower limit ahead and to the end of the overlap behind the stop, with b a
fraction of the full service braking on level track. The protection knows the true position: it stands
for a system with a safe odometer of its own, whose margins are no subject of this bench.

Departure is authorised when the doors are closed and the ATO has been READY once and
`departure_delay_s` ago; not before. Above the permitted speed plus a margin it orders an emergency
stop, until the train stands. It orders; it does not brake: what the controller does is under test.

Temporary speed restrictions come up during the run: from `from_s` on they count as limits, and
ATP_Restriction tells the ATO. One that is announced when the train cannot brake to it any more ends in an
emergency stop; a comfortable plan needs v^2 / 1.6 metres for it, and the way of two seconds.
"""

from __future__ import annotations

from bisect import bisect_right
from math import ceil, floor, sqrt

from hil.railway import Journey
from plant_sim.config import AtpTable, RestrictionTable

READY = 1
"""ATO_Command.Mode of an ATO that waits for departure."""

REPEAT_S = 1.0
"""A restriction is told again so often: one lost frame must not hide it."""

START_STEP_M, LENGTH_STEP_M, LIMIT_STEP_KMH = 0.1, 0.5, 1.0
"""Steps of ATP_Restriction; what is told is rounded to the safe side."""
ROUNDING = 1e-9


class Protection:
    """The ATP of one journey; `update` once a cycle, then read the attributes."""

    def __init__(self, journey: Journey, table: AtpTable, length_m: float) -> None:
        self._table = table
        edges, limits = journey.line.speed_limit_profile(length_m)
        self._edges = [float(x) for x in edges[:-1]]  # where limit i begins
        self._limits = [float(v) for v in limits]
        self._stop_m = journey.destination.position_m
        self._braking = table.braking_factor * journey.train.max_braking_mps2
        self._length_m = length_m
        self._restrictions = table.restrictions
        self._told_s: list[float | None] = [None] * len(table.restrictions)
        self._in_force: list[tuple[float, float, float]] = []  # begin, end [m] for the front, limit [m/s]
        self.announcements: list[dict[str, float]] = []
        self._ready_since_s: float | None = None
        self.doors_closed = False
        self.departure_authorised = False
        self.emergency_stop = False
        self.permitted_speed_mps = self.permitted_mps(journey.origin.position_m)
        self.target_speed_mps, self.target_distance_m = self.target(journey.origin.position_m)

    def update(self, time_s: float, position_m: float, speed_mps: float, mode: int) -> None:
        """Take the time since the start, true position and speed, and the ATO's mode (0 if unknown)."""
        self.announcements = [] if not self._restrictions else self._announced(time_s)
        self.permitted_speed_mps = self.permitted_mps(position_m)
        self.target_speed_mps, self.target_distance_m = self.target(position_m)
        if abs(speed_mps) > self.permitted_speed_mps + self._table.emergency_margin_mps:
            self.emergency_stop = True
        elif speed_mps == 0.0:
            self.emergency_stop = False
        self.doors_closed = self.doors_closed or time_s >= self._table.doors_close_s
        if self._ready_since_s is None and mode == READY:
            self._ready_since_s = time_s
        self.departure_authorised = (
            self.doors_closed
            and self._ready_since_s is not None
            and time_s >= self._ready_since_s + self._table.departure_delay_s
        )

    def permitted_mps(self, front_m: float) -> float:
        """Permitted speed [m/s] of a train with its front here."""
        index = max(0, bisect_right(self._edges, front_m) - 1)
        twice_braking = 2.0 * self._braking
        overlap_end_m = self._stop_m + self._table.overlap_m
        lowest = min(self._limits[index] ** 2, max(0.0, twice_braking * (overlap_end_m - front_m)))
        for ahead in range(index + 1, len(self._edges)):
            reserve = twice_braking * (self._edges[ahead] - front_m)
            if reserve >= lowest:
                break  # so far away that even a stop there would permit more
            lowest = min(lowest, self._limits[ahead] ** 2 + reserve)
        for begin_m, end_m, limit_mps in self._in_force:
            if front_m < end_m:
                lowest = min(lowest, limit_mps**2 + twice_braking * max(0.0, begin_m - front_m))
        return sqrt(lowest)

    def target(self, front_m: float) -> tuple[float, float]:
        """Speed permitted at the next place where it is lower than here, and the distance to it."""
        speed_mps, distance_m = self._line_target(front_m)
        for begin_m, _, limit_mps in self._in_force:
            if 0.0 <= begin_m - front_m < distance_m:
                speed_mps, distance_m = limit_mps, begin_m - front_m
        return speed_mps, distance_m

    def _announced(self, time_s: float) -> list[dict[str, float]]:
        """What ATP_Restriction says in this cycle: restrictions that come up, and those to be repeated."""
        told = []
        for number, restriction in enumerate(self._restrictions):
            if time_s < restriction.from_s:
                continue
            last_s = self._told_s[number]
            if last_s is None:
                end_m = restriction.end_m + self._length_m
                self._in_force.append((restriction.start_m, end_m, restriction.limit_kmh / 3.6))
            if last_s is None or time_s - last_s >= REPEAT_S - ROUNDING:
                self._told_s[number] = time_s
                told.append(restriction_message(number, restriction))
        return told

    def _line_target(self, front_m: float) -> tuple[float, float]:
        index = max(0, bisect_right(self._edges, front_m) - 1)
        for ahead in range(index + 1, len(self._edges)):
            if self._edges[ahead] >= self._stop_m:
                break
            if self._limits[ahead] < self._limits[index]:
                return self._limits[ahead], self._edges[ahead] - front_m
        return 0.0, max(0.0, self._stop_m - front_m)


def restriction_message(number: int, restriction: RestrictionTable) -> dict[str, float]:
    """Values of ATP_Restriction (SI): the section at least, the limit at most."""
    start_m = START_STEP_M * floor(restriction.start_m / START_STEP_M + ROUNDING)
    length_m = LENGTH_STEP_M * ceil((restriction.end_m - start_m) / LENGTH_STEP_M - ROUNDING)
    limit_kmh = LIMIT_STEP_KMH * floor(restriction.limit_kmh / LIMIT_STEP_KMH + ROUNDING)
    return {"Number": number, "Start": start_m, "Length": length_m, "Limit": limit_kmh / 3.6}
