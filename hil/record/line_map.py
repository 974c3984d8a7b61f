"""The line under the train: profile, limits, stations, curves and tunnels, and the train moving on it.

The recorder knows no railway. Whoever starts it may describe the line in its properties as `track`, plain
JSON in metres and metres per second (`hil.bench.track` writes it); the drawing shares its horizontal axis
with the chart over distance above it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.record.dashboard import BLUE, GREY, LIMIT, ORANGE, WHITE
from hil.record.distance import HEIGHT, WIDTH, DistanceChart, Plane
from hil.record.errors import RecordError
from hil.record.rerun_sink import RerunSink
from hil.record.timelines import Instants

__all__ = ["MAP_DEPTH", "LineMap", "Track"]

ENTITY = "/over_distance/line"
MAP_DEPTH = 0.72 * HEIGHT
"""How far the drawing reaches below the chart."""

PROFILE_TOP, PROFILE_BOTTOM, CURVE_ROW, NAME_ROW = 0.2 * HEIGHT, 0.33 * HEIGHT, 0.42 * HEIGHT, 0.5 * HEIGHT
LEAST_RELIEF_M = 4.0  # a level line is drawn level
GROUND, TUNNEL, CURVE, STATION, TRAIN = 0x6B7078FF, 0x3A3F47FF, 0x7C6BB0FF, 0xB9C0CAFF, ORANGE
MOST_MOVES_PER_S = 5
LEAST_MOVE_M = 0.1
MARGIN_SHARE = 0.01
Array = NDArray[np.float64]
Sections = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Track:
    """A line as far as it is drawn, m and m/s; sections are (start, end, value), gradients in permille."""

    start_m: float
    end_m: float
    stops: tuple[tuple[str, float], ...] = ()
    limits: Sections = ()
    gradients: Sections = ()
    curves: Sections = ()
    tunnels: tuple[tuple[float, float], ...] = ()
    balises: tuple[float, ...] = ()
    train_length_m: float = 0.0

    @classmethod
    def read(cls, table: Any) -> Track | None:
        """From a recording's property `track`; None if there is none. Raises RecordError."""
        if table is None:
            return None
        try:
            track = cls(
                start_m=float(table["start_m"]),
                end_m=float(table["end_m"]),
                stops=tuple((str(name), float(at)) for name, at in table.get("stops", ())),
                limits=_sections(table.get("limits_mps", ())),
                gradients=_sections(table.get("gradients_permille", ())),
                curves=_sections(table.get("curves_m", ())),
                tunnels=tuple((float(start), float(end)) for start, end in table.get("tunnels", ())),
                balises=tuple(float(at) for at in table.get("balises_m", ())),
                train_length_m=float(table.get("train_length_m", 0.0)),
            )
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise RecordError(f"properties, track: cannot be drawn: {type(error).__name__} {error}") from None
        if not track.end_m > track.start_m:
            raise RecordError(
                f"properties, track: end_m {track.end_m:g} must exceed start_m {track.start_m:g}"
            )
        return track

    def elevation(self) -> tuple[Array, Array]:
        """Height [m] over distance [m], 0 at the start, from the gradients; a gap between them is level."""
        places = {self.start_m, self.end_m}
        for start, end, _ in self.gradients:
            places |= {start, end}
        at = np.array(sorted(place for place in places if self.start_m <= place <= self.end_m))
        middle = 0.5 * (at[1:] + at[:-1])
        slope = np.zeros(len(middle))
        for start, end, permille in self.gradients:
            slope[(middle > start) & (middle < end)] = permille * 1e-3
        return at, np.concatenate(([0.0], np.cumsum(slope * np.diff(at))))

    def limit_steps(self) -> tuple[Array, Array]:
        """Speed limits [m/s] as a line with upright steps over distance [m]."""
        ordered = sorted(s for s in self.limits if s[1] > self.start_m and s[0] < self.end_m)
        at = [x for start, end, _ in ordered for x in (max(start, self.start_m), min(end, self.end_m))]
        return np.array(at), np.repeat([value for _, _, value in ordered], 2).astype(np.float64)


class LineMap:
    """Draws a track once, and the train wherever its odometer says."""

    def __init__(self, track: Track, sink: RerunSink) -> None:
        self.track = track
        self._sink = sink
        margin = MARGIN_SHARE * (track.end_m - track.start_m)
        self.span = (track.start_m - max(margin, 0.0), track.end_m + margin)
        self._plane = Plane(*self.span, 0.0, 1.0)
        self._at, height = track.elevation()
        relief = max(float(height.max() - height.min()), LEAST_RELIEF_M)
        share = (height - 0.5 * (height.max() + height.min())) / relief + 0.5
        self._down = PROFILE_BOTTOM - share * (PROFILE_BOTTOM - PROFILE_TOP)
        self._last: tuple[int, float] | None = None
        self._moved = False

    def prepare(self, chart: DistanceChart | None, mps_in_unit: float) -> None:
        """Give the chart above the same axis and the limits; `mps_in_unit` is 1 m/s in the chart's unit."""
        if chart is not None:
            chart.span = self.span
            at, limits = self.track.limit_steps()
            if len(at):
                chart.add_fixed("line_limit", at, limits * mps_in_unit, LIMIT)

    def draw(self) -> None:
        """Log what does not move."""
        track, sink = self.track, self._sink
        profile = self._on_profile(self._at)
        if track.tunnels:
            tubes = [self._on_profile(self._between(start, end)) for start, end in track.tunnels]
            sink.drawing(f"{ENTITY}/tunnels", tubes, TUNNEL, 16.0)
        sink.drawing(f"{ENTITY}/profile", [profile], GROUND, 2.5)
        self._draw_gradients()
        self._draw_curves()
        self._draw_stations()
        if track.balises:
            ticks = [self._upright(at, 6.0) for at in track.balises]
            sink.drawing(f"{ENTITY}/balises", ticks, BLUE, 2.0)

    def move(self, instants: Instants, position_m: Array) -> None:
        """Log where the front of the train was; several times a second while it moves."""
        rows = self._worth_drawing(instants.bus_ns, position_m)
        if not len(rows):
            return
        fronts = position_m[rows]
        rears = fronts - self.track.train_length_m
        bodies = [
            self._on_profile(self._between(rear, front)) for rear, front in zip(rears, fronts, strict=True)
        ]
        x = self._plane.points(fronts, np.zeros(len(fronts)))[:, 0]
        cursors = [np.array([[each, -HEIGHT], [each, PROFILE_BOTTOM]]) for each in x]
        at = instants.take(rows)
        if not self._moved:
            at, self._moved = at.from_start(), True
        self._sink.moving(f"{ENTITY}/train", at, bodies, TRAIN, 9.0)
        self._sink.moving(f"{ENTITY}/front", at, cursors, 0xF59B4299, 1.0)

    def _worth_drawing(self, times_ns: NDArray[np.int64], position_m: Array) -> NDArray[np.intp]:
        step_ns = 1_000_000_000 // MOST_MOVES_PER_S
        slots = times_ns // step_ns
        before = -1 if self._last is None else self._last[0]
        rows = np.flatnonzero(np.diff(slots, prepend=before) != 0)
        rows = rows[np.isfinite(position_m[rows])]
        kept = []
        place = np.inf if self._last is None else self._last[1]
        for row in rows.tolist():
            if abs(position_m[row] - place) >= LEAST_MOVE_M:
                kept.append(row)
                place = float(position_m[row])
        if len(slots):
            self._last = (int(slots[-1]), place)
        return np.array(kept, dtype=np.intp)

    def _draw_gradients(self) -> None:
        shortest = 0.035 * (self.span[1] - self.span[0])
        wide = [s for s in self.track.gradients if self._seen(s[0], s[1]) >= shortest and s[2]]
        if wide:
            middles = np.array([self._middle(start, end) for start, end, _ in wide])
            places = self._on_profile(middles) + np.array([0.0, 0.015 * HEIGHT])
            texts = [f"{permille:+.3g} ‰" for _, _, permille in wide]
            self._sink.labels(f"{ENTITY}/gradients", places, texts, GREY)

    def _draw_curves(self) -> None:
        curves = [s for s in self.track.curves if self._seen(s[0], s[1]) > 0]
        if not curves:
            return
        strips, places, texts = [], [], []
        for start, end, radius in curves:
            left, right = self._x(max(start, self.span[0])), self._x(min(end, self.span[1]))
            strips.append(
                np.array(
                    [[left, CURVE_ROW], [left, CURVE_ROW - 5], [right, CURVE_ROW - 5], [right, CURVE_ROW]]
                )
            )
            if right - left > 0.035 * WIDTH:
                places.append([0.5 * (left + right), CURVE_ROW - 5])
                texts.append(f"R {abs(radius):g} m")
        self._sink.drawing(f"{ENTITY}/curves", strips, CURVE, 2.0)
        if places:
            self._sink.labels(f"{ENTITY}/radii", np.array(places), texts, CURVE)

    def _draw_stations(self) -> None:
        stops = [(name, at) for name, at in self.track.stops if self.span[0] <= at <= self.span[1]]
        if not stops:
            return
        x = [self._x(at) for _, at in stops]
        posts = [np.array([[each, 0.14 * HEIGHT], [each, NAME_ROW]]) for each in x]
        self._sink.drawing(f"{ENTITY}/stations", posts, STATION, 1.5)
        places = np.array([[each, NAME_ROW] for each in x])
        self._sink.labels(f"{ENTITY}/names", places, [name for name, _ in stops], WHITE)

    def _between(self, start: float, end: float) -> Array:
        inner = self._at[(self._at > start) & (self._at < end)]
        return np.concatenate(([start], inner, [end]))

    def _on_profile(self, at: Array) -> Array:
        x = self._plane.points(at, np.zeros(len(at)))[:, 0]
        return np.column_stack((x, np.interp(at, self._at, self._down)))

    def _upright(self, at: float, length: float) -> Array:
        foot = self._on_profile(np.array([at]))[0]
        return np.array([foot, foot - np.array([0.0, length])])

    def _x(self, at: float) -> float:
        return float(self._plane.points(np.array([at]), np.zeros(1))[0, 0])

    def _seen(self, start: float, end: float) -> float:
        return min(end, self.span[1]) - max(start, self.span[0])

    def _middle(self, start: float, end: float) -> float:
        return 0.5 * (max(start, self.span[0]) + min(end, self.span[1]))


def _sections(rows: Sequence[Sequence[float]]) -> Sections:
    return tuple((float(start), float(end), float(value)) for start, end, value in rows)
