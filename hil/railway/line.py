"""The line as both sides may know it: stops, limits, gradients, curves, tunnels, balises.

Position is the running distance in the direction of travel; where x = 0 lies is free. Sections are
half-open, [start, end). A gap between gradients is level, a gap between limits has the default
limit, and outside the line the track is level and straight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np

from hil.railway.errors import RailwayDataError
from hil.railway.resistance import CURVE_COEFFICIENT, curve_n_per_kn
from hil.railway.track import FloatArray, TrackResistance


@dataclass(frozen=True)
class Stop:
    """Where the front of the train shall stand."""

    name: str
    position_m: float


@dataclass(frozen=True)
class SpeedLimit:
    """Permitted speed of a section; it holds while any part of the train is in it."""

    start_m: float
    end_m: float
    limit_mps: float


@dataclass(frozen=True)
class Gradient:
    """Gradient of a section, positive uphill."""

    start_m: float
    end_m: float
    permille: float


@dataclass(frozen=True)
class Curve:
    """Curve of constant radius; transitions count to the body."""

    start_m: float
    end_m: float
    radius_m: float


@dataclass(frozen=True)
class Tunnel:
    """Tunnel with its specific resistance (see `resistance.tunnel_n_per_kn`)."""

    start_m: float
    end_m: float
    resistance_n_per_kn: float


@dataclass(frozen=True)
class Balise:
    """Fixed transponder: a train that passes it learns where it is."""

    number: int
    position_m: float


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line in one direction of travel; order, overlap and containment are checked on creation.

    `start_m` and `end_m` bound everything that lies on the line; a train may reach beyond them.
    Raises RailwayDataError, which names the key and the two values that contradict.
    """

    name: str
    title: str = ""
    source: str = ""
    start_m: float
    end_m: float
    default_limit_mps: float
    stops: tuple[Stop, ...] = ()
    speed_limits: tuple[SpeedLimit, ...] = ()
    gradients: tuple[Gradient, ...] = ()
    curves: tuple[Curve, ...] = ()
    tunnels: tuple[Tunnel, ...] = ()
    balises: tuple[Balise, ...] = ()
    curve_coefficient: float = CURVE_COEFFICIENT  # [N/kN m]

    def __post_init__(self) -> None:
        if not self.end_m > self.start_m:
            raise RailwayDataError(f"end_m: {self.end_m:g} must be greater than start_m = {self.start_m:g}")
        for key in ("speed_limits", "gradients", "curves", "tunnels"):
            _check_sections(key, getattr(self, key), self.start_m, self.end_m)
        _check_places("stops", [(s.name, s.position_m) for s in self.stops], self.start_m, self.end_m)
        places = [(str(b.number), b.position_m) for b in self.balises]
        _check_places("balises", places, self.start_m, self.end_m)

    def stop(self, which: str | int) -> Stop:
        """Stop by its name, or by its index in `stops`; RailwayDataError lists the names."""
        if isinstance(which, int):
            if not 0 <= which < len(self.stops):
                raise RailwayDataError(f"line {self.name}: no stop {which}; it has {len(self.stops)}")
            return self.stops[which]
        for stop in self.stops:
            if stop.name == which:
                return stop
        names = ", ".join(repr(stop.name) for stop in self.stops) or "none"
        raise RailwayDataError(f"line {self.name}: no stop {which!r}; it has {names}")

    def capped(self, max_speed_mps: float) -> Line:
        """The line with no limit above this speed, as a train of that maximum speed may use it."""
        limits = [self.default_limit_mps, *(section.limit_mps for section in self.speed_limits)]
        if max(limits) <= max_speed_mps:
            return self
        return replace(
            self,
            default_limit_mps=min(self.default_limit_mps, max_speed_mps),
            speed_limits=tuple(
                replace(section, limit_mps=min(section.limit_mps, max_speed_mps))
                for section in self.speed_limits
            ),
        )

    def speed_limit_mps(self, front_m: float, length_m: float = 0.0) -> float:
        """Lowest limit [m/s] anywhere under a train with its front here."""
        rear_m = front_m - length_m
        limit = None
        covered_to = rear_m
        bare = False  # some part of the train stands where only the default holds
        for section in self._limits_by_start:
            if section.end_m <= rear_m:
                continue
            if section.start_m > front_m:
                break
            bare = bare or section.start_m > covered_to
            covered_to = section.end_m
            limit = section.limit_mps if limit is None else min(limit, section.limit_mps)
        if limit is None:
            return self.default_limit_mps
        if bare or covered_to <= front_m:
            return min(limit, self.default_limit_mps)
        return limit

    def speed_limit_profile(self, length_m: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Limits as the front sees them: `(edges_m (n+1), limit_mps (n))` from start_m to end_m.

        A low limit lasts until the rear has left it; neighbours of the same limit are merged.
        """
        places = {self.start_m, self.end_m}
        for section in self.speed_limits:
            places |= {section.start_m, section.end_m, section.start_m + length_m, section.end_m + length_m}
        inside = sorted(p for p in places if self.start_m <= p <= self.end_m)
        edges = [inside[0]]
        limits: list[float] = []
        for left, right in pairwise(inside):
            limit = self.speed_limit_mps(0.5 * (left + right), length_m)
            if limits and limits[-1] == limit:
                edges[-1] = right
            else:
                edges.append(right)
                limits.append(limit)
        return np.array(edges, dtype=np.float64), np.array(limits, dtype=np.float64)

    def gradient_permille(self, position_m: float) -> float:
        """Gradient at one point [permille], positive uphill."""
        return self._gradient_steps.at(position_m)

    def mean_gradient(self, front_m: float, length_m: float) -> float:
        """Gradient averaged over a train of uniform mass [permille], positive uphill."""
        return self._gradient_steps.mean(front_m, length_m)

    def mean_specific_resistance(self, front_m: float, length_m: float = 0.0) -> float:
        """Gradient, curve and tunnel resistance averaged over a train of uniform mass [N/kN]."""
        return self.track_resistance.mean(front_m, length_m)

    @cached_property
    def track_resistance(self) -> TrackResistance:
        """Gradient, curve and tunnel resistance as arrays, with the exact integral."""
        curves = [
            (c.start_m, c.end_m, curve_n_per_kn(c.radius_m, self.curve_coefficient)) for c in self.curves
        ]
        gradients = [(g.start_m, g.end_m, g.permille) for g in self.gradients]
        tunnels = [(t.start_m, t.end_m, t.resistance_n_per_kn) for t in self.tunnels]
        return self._steps([*gradients, *curves, *tunnels])

    def breakpoints(self) -> FloatArray:
        """Ascending positions [m] where a limit or the track resistance may change, ends included."""
        places = {self.start_m, self.end_m}
        sections: tuple[_Section, ...] = (*self.speed_limits, *self.gradients, *self.curves, *self.tunnels)
        for section in sections:
            places |= {section.start_m, section.end_m}
        return np.array(sorted(places), dtype=np.float64)

    @cached_property
    def _gradient_steps(self) -> TrackResistance:
        return self._steps([(g.start_m, g.end_m, g.permille) for g in self.gradients])

    @cached_property
    def _limits_by_start(self) -> tuple[SpeedLimit, ...]:
        return tuple(sorted(self.speed_limits, key=lambda section: section.start_m))

    def _steps(self, sections: Sequence[tuple[float, float, float]]) -> TrackResistance:
        places = {self.start_m, self.end_m}
        for start_m, end_m, _ in sections:
            places |= {start_m, end_m}
        edges = np.array(sorted(places), dtype=np.float64)
        values = np.zeros(len(edges) - 1)
        for start_m, end_m, value in sections:
            values[(edges[:-1] >= start_m) & (edges[:-1] < end_m)] += value
        return TrackResistance.from_steps(edges, values)


class _Section(Protocol):
    @property
    def start_m(self) -> float: ...
    @property
    def end_m(self) -> float: ...


def _check_sections(key: str, sections: Sequence[_Section], start_m: float, end_m: float) -> None:
    for number, section in enumerate(sections, 1):
        if not section.end_m > section.start_m:
            raise RailwayDataError(
                f"{key}#{number}.end_m: {section.end_m:g} must be greater than start_m = {section.start_m:g}"
            )
        if section.start_m < start_m or section.end_m > end_m:
            raise RailwayDataError(
                f"{key}#{number}: {section.start_m:g} to {section.end_m:g} m "
                f"must lie on the line, {start_m:g} to {end_m:g} m"
            )
    ordered = sorted(sections, key=lambda section: section.start_m)
    for before, after in pairwise(ordered):
        if after.start_m < before.end_m:
            raise RailwayDataError(
                f"{key}: {after.start_m:g} to {after.end_m:g} m overlaps "
                f"{before.start_m:g} to {before.end_m:g} m; sections of one kind must not overlap"
            )


def _check_places(key: str, places: Sequence[tuple[str, float]], start_m: float, end_m: float) -> None:
    seen: set[str] = set()
    for number, (name, position_m) in enumerate(places, 1):
        if not start_m <= position_m <= end_m:
            raise RailwayDataError(
                f"{key}#{number}.position_m: {position_m:g} ({name}) "
                f"must lie on the line, {start_m:g} to {end_m:g} m"
            )
        if name in seen:
            raise RailwayDataError(f"{key}#{number}: {name} is there twice; each must be unique")
        seen.add(name)
