"""What an energy-optimal speed profile is asked for: the track ahead, the train, the limits and the time.

The independent variable is the distance travelled s, from 0. Between two nodes the acceleration is constant,
so the kinetic energy per mass y = v^2/2 is linear in s, and a limit that holds at both nodes holds between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controller.profile.drive_map import DriveMap
from controller.profile.mesh import DEFAULT_STEP_M, mesh
from controller.profile.profile import Floats, ProfileError
from hil.railway import Curve, DavisCoefficients, EffortCurve, Gradient, Line, SpeedLimit, Stop, Train, Tunnel


@dataclass(frozen=True)
class Efforts:
    """Largest effort over speed: a force, a power hyperbola and a table, the lowest of those given.

    `points` are `(speed_mps, effort_n)` with ascending speeds, constant beyond the ends. Nothing
    given: no limit.
    """

    max_force_n: float | None = None
    max_power_w: float | None = None
    points: tuple[tuple[float, float], ...] = ()

    @classmethod
    def of_curve(cls, curve: EffortCurve) -> Efforts:
        """The same limits as a curve of railway data."""
        return cls(curve.max_effort_n, curve.max_power_w, curve.points)

    def force_n(self, speed_mps: Floats) -> Floats:
        """Effort available [N] at these speeds, inf where nothing limits it."""
        force = np.full(np.shape(speed_mps), np.inf if self.max_force_n is None else self.max_force_n)
        if self.max_power_w is not None:
            force = np.minimum(force, self.max_power_w / np.maximum(speed_mps, 1e-9))
        if self.points:
            speeds, efforts = zip(*self.points, strict=True)
            force = np.minimum(force, np.interp(speed_mps, speeds, efforts))
        return force


class Infeasible(ProfileError):
    """No profile keeps this time: `min_time_s` is the least possible (inf: none), `binding` names the limit.

    `binding` is the limit of which one per cent more would save most time.
    """

    def __init__(self, message: str, *, min_time_s: float, binding: str) -> None:
        super().__init__(message)
        self.min_time_s = min_time_s
        self.binding = binding


@dataclass(frozen=True, kw_only=True)
class Problem:
    """An energy-optimal profile over N stages, N+1 nodes.

    Shapes: `position_m` (N+1) ascending from 0; `speed_limit_mps` and `track_n_per_kn` (N), the latter the
    specific resistance of gradient, curve and tunnel [N/kN], positive against the travel.

    Minimised is the energy at the line: traction work / `traction_efficiency` less
    `regeneration_efficiency` times the regenerated work. `braking` limits the regenerative brake, beyond
    which a friction brake works if `pneumatic`, else nothing. Force times speed keeps the power limits at
    both nodes of a stage. `max_braking_n` limits all brakes together, if given. Decelerations too are
    positive numbers. `drive` adds what no convex problem has. ProfileError where values contradict each
    other.
    """

    position_m: Floats
    speed_limit_mps: Floats
    track_n_per_kn: Floats
    mass_kg: float
    effective_mass_kg: float
    davis: DavisCoefficients
    traction: Efforts = Efforts()
    braking: Efforts = Efforts()
    pneumatic: bool = True
    max_braking_n: float | None = None
    max_acceleration_mps2: float
    max_deceleration_mps2: float
    start_speed_mps: float = 0.0
    end_speed_mps: float = 0.0
    traction_efficiency: float = 1.0
    regeneration_efficiency: float = 0.0
    drive: DriveMap | None = None
    time_s: float

    def __post_init__(self) -> None:
        stages = len(self.position_m) - 1
        if stages < 2 or len(self.speed_limit_mps) != stages or len(self.track_n_per_kn) != stages:
            raise ProfileError(
                f"problem: {stages + 1} nodes need {stages} speed limits and track resistances, not "
                f"{len(self.speed_limit_mps)} and {len(self.track_n_per_kn)}, and at least two stages"
            )
        for name in ("position_m", "speed_limit_mps", "track_n_per_kn"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise ProfileError(f"problem: {name}: every value must be finite")
            getattr(self, name).setflags(write=False)
        if np.any(np.diff(self.position_m) <= 0.0):
            raise ProfileError("problem: position_m must ascend")
        positive = (
            "mass_kg",
            "effective_mass_kg",
            "max_acceleration_mps2",
            "max_deceleration_mps2",
            "time_s",
        )
        for name in positive:
            _require(
                name, getattr(self, name), 0.0 < getattr(self, name) < np.inf, "greater than 0 and finite"
            )
        lowest = float(np.min(self.speed_limit_mps))
        _require("speed_limit_mps", lowest, lowest > 0.0, "greater than 0")
        for name in ("start_speed_mps", "end_speed_mps"):
            _require(name, getattr(self, name), 0.0 <= getattr(self, name) < np.inf, "at least 0 and finite")
        _require("traction_efficiency", self.traction_efficiency, 0.0 < self.traction_efficiency <= 1.0,
                 "above 0 and at most 1")  # fmt: skip
        _require("regeneration_efficiency", self.regeneration_efficiency,
                 0.0 <= self.regeneration_efficiency <= 1.0, "from 0 to 1")  # fmt: skip
        if self.traction_efficiency * self.regeneration_efficiency >= 1.0:
            raise ProfileError(
                "problem: traction_efficiency times regeneration_efficiency must be below 1; with a brake "
                "that gives back all that traction took, no profile is better than another"
            )

    @property
    def length_m(self) -> float:
        """Distance to run [m]."""
        return float(self.position_m[-1] - self.position_m[0])

    @property
    def stages(self) -> int:
        """Number of stages N."""
        return len(self.position_m) - 1

    @property
    def node_limit_mps(self) -> Floats:
        """Highest speed at each node (N+1): the lower of the limits on its two sides."""
        limit = self.speed_limit_mps
        return np.minimum(np.concatenate((limit[:1], limit)), np.concatenate((limit, limit[-1:])))

    def with_time(self, time_s: float) -> Problem:
        """The same problem with another trip time."""
        return replace(self, time_s=time_s)

    @classmethod
    def of_line(
        cls,
        line: Line,
        train: Train,
        start_m: float,
        end_m: float,
        time_s: float,
        *,
        train_length_m: float = 0.0,
        max_step_m: float = DEFAULT_STEP_M,
        max_acceleration_mps2: float | None = None,
        max_deceleration_mps2: float | None = None,
        traction_efficiency: float | None = None,
        regeneration_efficiency: float | None = None,
        pneumatic: bool | None = None,
        speed_restrictions: Sequence[SpeedLimit] = (),
        start_speed_mps: float = 0.0,
        end_speed_mps: float = 0.0,
    ) -> Problem:
        """Problem of a train on a line from `start_m` to `end_m`; a smaller `end_m` travels against the line.

        `train_length_m` 0 is a point mass: limits and gradients act on the front alone. Otherwise a limit
        lasts until the rear has left it and the track resistance is averaged over the train.
        `speed_restrictions` are limits beside the line's own, in the line's positions. What is None comes
        from the train. The fade-out of the motor brake near standstill is not modelled.
        """
        if start_m > end_m:
            line = mirrored(line)
            start_m, end_m = -start_m, -end_m
            speed_restrictions = [SpeedLimit(-r.end_m, -r.start_m, r.limit_mps) for r in speed_restrictions]
        line = line.capped(train.max_speed_mps)
        edges, limits = line.speed_limit_profile(train_length_m)
        sections = line.breakpoints()
        restricted = [(r.start_m, r.end_m + train_length_m, r.limit_mps) for r in speed_restrictions]
        places = [*edges, *sections, *(sections + train_length_m), *(p for r in restricted for p in r[:2])]
        nodes = mesh(start_m, end_m, places, max_step_m)
        if len(nodes) < 3:
            nodes = np.array([start_m, 0.5 * (start_m + end_m), end_m])
        middles = 0.5 * (nodes[1:] + nodes[:-1])
        index = np.clip(np.searchsorted(edges, middles, side="right") - 1, 0, len(limits) - 1)
        limit = np.where((middles < edges[0]) | (middles > edges[-1]), line.default_limit_mps, limits[index])
        for left, right, value in restricted:
            inside = (middles > left) & (middles < right)
            limit[inside] = np.minimum(limit[inside], value)
        track = np.array([line.mean_specific_resistance(float(x), train_length_m) for x in middles])
        return cls(
            position_m=nodes - nodes[0],
            speed_limit_mps=limit,
            track_n_per_kn=track,
            mass_kg=train.mass_kg,
            effective_mass_kg=train.effective_mass_kg,
            davis=train.davis,
            traction=Efforts.of_curve(train.traction.curve),
            braking=Efforts.of_curve(train.electrodynamic.curve),
            pneumatic=train.pneumatic.max_effort_n > 0.0 if pneumatic is None else pneumatic,
            max_acceleration_mps2=_given(max_acceleration_mps2, train.max_acceleration_mps2),
            max_deceleration_mps2=_given(max_deceleration_mps2, train.max_braking_mps2),
            start_speed_mps=start_speed_mps,
            end_speed_mps=end_speed_mps,
            traction_efficiency=_given(traction_efficiency, train.traction_efficiency),
            regeneration_efficiency=_given(regeneration_efficiency, train.regeneration_efficiency),
            time_s=time_s,
        )


def mirrored(line: Line) -> Line:
    """The line for travel the other way: position x becomes -x, gradients change sign."""
    return replace(
        line,
        start_m=-line.end_m,
        end_m=-line.start_m,
        stops=tuple(Stop(s.name, -s.position_m) for s in reversed(line.stops)),
        speed_limits=tuple(
            SpeedLimit(-s.end_m, -s.start_m, s.limit_mps) for s in reversed(line.speed_limits)
        ),
        gradients=tuple(Gradient(-g.end_m, -g.start_m, -g.permille) for g in reversed(line.gradients)),
        curves=tuple(Curve(-c.end_m, -c.start_m, c.radius_m) for c in reversed(line.curves)),
        tunnels=tuple(Tunnel(-t.end_m, -t.start_m, t.resistance_n_per_kn) for t in reversed(line.tunnels)),
        balises=(),
    )


def _given(value: float | None, default: float) -> float:
    return default if value is None else value


def _require(name: str, value: float, holds: bool, what: str) -> None:
    if not holds:
        raise ProfileError(f"problem: {name}: {value:g} must be {what}")
