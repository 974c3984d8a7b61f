"""Third-order extended-state observer: speed, the acceleration nobody told of, and how that changes.

    v' = b f - R + L + 3 w e      f: what the drive gives: reported, or modelled with dead time and lag
    L' = Ld + 3 w^2 e             R: modelled resistance
    Ld' = w^3 e                   e: measured minus estimated speed

All three poles are at -w. It gives speed and acceleration without noise, and without differencing the
quantised speed: the drive carries what is fast, the measurement corrects what is slow. What L learns under
effort is mostly a factor of it (another mass, a weaker brake), so it seeps into b, which is right at once
when the effort changes.
"""

from __future__ import annotations

from math import exp

from controller.laws import Drive, clamp

LEAST_FORCE_MPS2 = 0.5
"""Below this effort L says more of gradient and wind than of mass."""

LEAST_EFFECTIVENESS, MOST_EFFECTIVENESS = 0.75, 1.3
"""A train 20 % heavier or lighter has 0.83 or 1.25; what is beyond stays in L. A gradient taken for a mass
makes the loop stronger by the inverse, and must not make it swing."""

AGREEMENT = 0.25
"""Share of a step of the measured speed that is no news. A rounded value says no more than half a step;
with all of that the estimate hunts between its edges, with none of it every step is felt in the demand."""


class ExtendedStateObserver:
    """One correction by `correct(speed)` at each sample, then one prediction by `predict(demand, ...)`."""

    speed_mps: float
    unmodelled_mps2: float
    """L: acceleration beyond drive and modelled resistance; positive pushes forward."""
    unmodelled_rate_mps3: float
    """Ld, its rate."""
    drive_mps2: float
    """f: what the drive gives now, over the nominal mass."""
    effectiveness: float
    """b: what of it becomes acceleration; nominal over true mass, for a drive that gives what it says."""

    def __init__(
        self,
        *,
        drive: Drive,
        bandwidth_per_s: float,
        learning_s: float,
        limit_mps2: float,
        resolution_mps: float,
        dt_s: float,
    ) -> None:
        """`limit_mps2` bounds |L|; `dt_s` is the sample time that the observer is made for.

        `learning_s`: time constant with which L turns into effectiveness, 0: never. `resolution_mps`: step
        of the measured speed; closer than `AGREEMENT` of it, measurement and estimate agree.
        """
        self._seeping = dt_s / learning_s if learning_s > 0.0 else 0.0
        self._agreement = AGREEMENT * resolution_mps
        self._w = bandwidth_per_s
        self._limit = limit_mps2
        self._dt_s = dt_s
        self._decay = exp(-dt_s / drive.lag_s) if drive.lag_s > 0.0 else 0.0
        self._orders = [0.0] * max(1, round(drive.dead_time_s / dt_s) + 1)
        self.reset()

    def reset(self) -> None:
        """Before the first sample."""
        self._started = False
        self._next = 0
        self.speed_mps = self.unmodelled_mps2 = self.unmodelled_rate_mps3 = self.drive_mps2 = 0.0
        self.effectiveness = 1.0
        self._fill(0.0)

    def correct(self, speed_mps: float, force_mps2: float) -> None:
        """Take a measured speed; the first one also sets the drive to `force_mps2`, its steady state."""
        if not self._started:
            self._started = True
            self.speed_mps = speed_mps
            self.drive_mps2 = force_mps2
            self._fill(force_mps2)
            return
        w = self._w
        error, dt = speed_mps - self.speed_mps, self._dt_s
        error -= clamp(error, -self._agreement, self._agreement)
        self.speed_mps += 3.0 * w * dt * error
        free = self.unmodelled_mps2 + 3.0 * w * w * dt * error
        self.unmodelled_mps2 = clamp(free, -self._limit, self._limit)
        if free == self.unmodelled_mps2:
            self.unmodelled_rate_mps3 += w * w * w * dt * error
        else:
            self.unmodelled_rate_mps3 = 0.0

    def report(self, force_mps2: float) -> None:
        """Take what the drive says it gives now in place of the model's value."""
        self.drive_mps2 = force_mps2

    def acceleration_mps2(self, resistance_mps2: float) -> float:
        """Estimated acceleration now."""
        return self.effectiveness * self.drive_mps2 - resistance_mps2 + self.unmodelled_mps2

    def force_mps2(self, acceleration_mps2: float, resistance_mps2: float, lead_s: float) -> float:
        """Order to the drive that gives this acceleration, against L as it will be `lead_s` later."""
        unmodelled = self.unmodelled_mps2 + lead_s * self.unmodelled_rate_mps3
        return (acceleration_mps2 + resistance_mps2 - unmodelled) / self.effectiveness

    def predict(self, force_mps2: float, resistance_mps2: float) -> None:
        """Go on by one sample with this order to the drive (demand plus resistance, as sent)."""
        dt = self._dt_s
        orders = self._orders
        orders[self._next] = force_mps2
        self._next = (self._next + 1) % len(orders)
        oldest = orders[self._next]  # with a ring of one: the order itself
        before = self.drive_mps2
        self.drive_mps2 = oldest + (before - oldest) * self._decay
        mean = 0.5 * (before + self.drive_mps2)
        self.speed_mps += dt * (self.effectiveness * mean - resistance_mps2 + self.unmodelled_mps2)
        self.unmodelled_mps2 += dt * self.unmodelled_rate_mps3
        self._seep(mean)

    def _seep(self, force_mps2: float) -> None:
        """Turn some of L into effectiveness; their sum, which is all that is felt now, stays."""
        if abs(force_mps2) < LEAST_FORCE_MPS2:
            return
        before = self.effectiveness
        free = before + self._seeping * self.unmodelled_mps2 / force_mps2
        self.effectiveness = clamp(free, LEAST_EFFECTIVENESS, MOST_EFFECTIVENESS)
        self.unmodelled_mps2 -= (self.effectiveness - before) * force_mps2

    def _fill(self, force_mps2: float) -> None:
        self._next = 0
        for k in range(len(self._orders)):
            self._orders[k] = force_mps2
