"""A chart over distance: the same series as over time, drawn as lines in a plane with its own axes.

A plot in the viewer runs over one timeline for all; a drawing shows distance beside time. It is replaced
as a whole every few seconds, and holds a bounded number of points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.record.dashboard import GREY, Chart
from hil.record.rerun_sink import RerunSink

__all__ = ["HEIGHT", "WIDTH", "DistanceChart", "Plane"]

WIDTH, HEIGHT = 2000.0, 210.0
"""Size of the plane in its own units; distance and value are scaled to fill it."""

MOST_POINTS = 1500
GRID = 0x26292EFF
TICKS = 6


@dataclass
class _Trace:
    """Points of one series, thinned to every `stride`-th."""

    distance_m: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    values: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    stride: int = 1
    skipped: int = 0

    def add(self, distance_m: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        chosen = slice((-self.skipped) % self.stride, None, self.stride)
        self.skipped = (self.skipped + len(values)) % self.stride
        self.distance_m = np.concatenate((self.distance_m, distance_m[chosen]))
        self.values = np.concatenate((self.values, values[chosen]))
        while len(self.values) > MOST_POINTS:
            self.distance_m, self.values = self.distance_m[::2], self.values[::2]
            self.stride *= 2


class DistanceChart:
    """Collects a chart's series over the position, and draws them."""

    def __init__(self, chart: Chart) -> None:
        self.chart = chart
        self.entity = f"/over_distance/{chart.path}"
        self.span: tuple[float, float] | None = None
        self._traces: dict[str, _Trace] = {}
        self._fixed: dict[str, tuple[NDArray[np.float64], NDArray[np.float64], int]] = {}

    def add_fixed(
        self, name: str, distance_m: NDArray[np.float64], values: NDArray[np.float64], color: int
    ) -> None:
        """A line that is known beforehand, in the chart's unit."""
        self._fixed[name] = (distance_m, values, color)

    def forget(self, name: str) -> None:
        """Drop the points of a series."""
        self._traces.pop(name, None)

    def add(self, name: str, position_m: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Take points of the series `name`."""
        known = np.isfinite(values)
        self._traces.setdefault(name, _Trace()).add(position_m[known], values[known])

    def draw(self, sink: RerunSink) -> None:
        """Replace the drawing by what is known now; nothing while the train has not moved."""
        traces = {name: trace for name, trace in self._traces.items() if len(trace.values) > 1}
        if self.span is not None:
            left, right = self.span
        elif traces:
            left = min(float(trace.distance_m.min()) for trace in traces.values())
            right = max(float(trace.distance_m.max()) for trace in traces.values())
        else:
            return
        if right - left < 1.0:
            return
        known = [trace.values for trace in traces.values()] + [
            values for _, values, _ in self._fixed.values()
        ]
        low = min(0.0, *(float(values.min()) for values in known)) if known else 0.0
        high = max((float(values.max()) for values in known), default=1.0)
        plane = Plane(left, right, low, max(high * 1.05, low + 1.0))
        self._draw_axes(sink, plane)
        for name, (distance_m, values, color) in self._fixed.items():
            sink.drawing(f"{self.entity}/{name}", [plane.points(distance_m, values)], color, 1.0)
        for series in self.chart.series:
            trace = traces.get(series.name)
            if trace is not None:
                points = plane.points(trace.distance_m, trace.values)
                sink.drawing(f"{self.entity}/{series.name}", [points], series.color, series.width)

    def _draw_axes(self, sink: RerunSink, plane: Plane) -> None:
        across, up = _ticks(plane.left, plane.right, 12), _ticks(plane.low, plane.high, 5)
        grid = [plane.points(np.array([x, x]), np.array([plane.low, plane.high])) for x in across]
        grid += [plane.points(np.array([plane.left, plane.right]), np.array([y, y])) for y in up]
        sink.drawing(f"{self.entity}/axes/grid", grid, GRID, 0.7)
        below, beside = np.full(len(across), plane.low), np.full(len(up), plane.left)
        places = np.concatenate(
            (
                plane.points(np.array(across), below) + np.array([0.0, 0.09 * HEIGHT]),
                plane.points(beside, np.array(up)) - np.array([0.018 * WIDTH, 0.1 * HEIGHT]),
            )
        )
        texts = [f"{x:g} m" for x in across] + [f"{y:g}" for y in up]
        sink.labels(f"{self.entity}/axes/labels", places, texts, GREY)


@dataclass(frozen=True)
class Plane:
    """Where a point of the chart lies in the plane; its vertical axis points down, as in a picture."""

    left: float
    right: float
    low: float
    high: float

    def points(self, distance_m: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Places in the plane, (n, 2), of n points of the chart."""
        across = (distance_m - self.left) / (self.right - self.left) * WIDTH
        up = (values - self.low) / (self.high - self.low) * HEIGHT
        return np.column_stack((across, -up))


def _ticks(low: float, high: float, count: int = TICKS) -> list[float]:
    """Round numbers between low and high, about `count` of them: steps of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= raw)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]
