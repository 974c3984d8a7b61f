"""ATP, the train protection: how fast the train may be, when it may leave, when it must stop at once.

Permitted speed: the lowest of the limits under the train and of the braking curves
sqrt(v_t^2 + 2 b d) to every lower limit ahead and to the end of the overlap behind the stop, with b a
fraction of the full service braking on level track. The protection knows the true position: it stands
for a system with a safe odometer of its own, whose margins are no subject of this bench.

Departure is authorised when the doors are closed and the ATO has been READY once and
`departure_delay_s` ago; not before. Above the permitted speed plus a margin it orders an emergency
stop, until the train stands. It orders; it does not brake: what the controller does is under test.
"""

from __future__ import annotations

from bisect import bisect_right
from math import sqrt

from hil.railway import Journey
from plant_sim.config import AtpTable

READY = 1
"""ATO_Command.Mode of an ATO that waits for departure."""


class Protection:
    """The ATP of one journey; `update` once a cycle, then read the attributes."""

    def __init__(self, journey: Journey, table: AtpTable, length_m: float) -> None:
        self._table = table
        edges, limits = journey.line.speed_limit_profile(length_m)
        self._edges = [float(x) for x in edges[:-1]]  # where limit i begins
        self._limits = [float(v) for v in limits]
        self._stop_m = journey.destination.position_m
        self._braking = table.braking_factor * journey.train.max_braking_mps2
        self._ready_since_s: float | None = None
        self.doors_closed = False
        self.departure_authorised = False
        self.emergency_stop = False
        self.permitted_speed_mps = self.permitted_mps(journey.origin.position_m)
        self.target_speed_mps, self.target_distance_m = self.target(journey.origin.position_m)

    def update(self, time_s: float, position_m: float, speed_mps: float, mode: int) -> None:
        """Take the time since the start, true position and speed, and the ATO's mode (0 if unknown)."""
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
        return sqrt(lowest)

    def target(self, front_m: float) -> tuple[float, float]:
        """Speed permitted at the next place where it is lower than here, and the distance to it."""
        index = max(0, bisect_right(self._edges, front_m) - 1)
        for ahead in range(index + 1, len(self._edges)):
            if self._edges[ahead] >= self._stop_m:
                break
            if self._limits[ahead] < self._limits[index]:
                return self._limits[ahead], self._edges[ahead] - front_m
        return 0.0, max(0.0, self._stop_m - front_m)
