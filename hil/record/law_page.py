"""The inside of a control law: its fuzzy surfaces with the operating point on them, and the rules that fire.

The recorder knows no law. Whoever starts it may describe one in its properties as `law_picture`, plain JSON
(the controller's configuration writes it). Strengths of the rules are computed here from the recorded inputs:
nothing of this runs in the control loop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.record.dashboard import GREY, ORANGE, PALETTE, WHITE, Chart, Level, Series, probe_color
from hil.record.errors import RecordError
from hil.record.rerun_sink import RerunSink
from hil.record.timelines import Instants

__all__ = ["CELL", "SURFACE", "Axis", "LawPage", "LawPicture", "Surface", "rule_strengths"]

SURFACE = 240
"""Width and height of a surface's picture in its own units."""

CELL = 40
"""Width and height of a rule's cell in its picture."""

MOST_ROWS_PER_S = 5
TRAIL_POINTS = 3000
COLD, MIDDLE, HOT = (38, 84, 160), (24, 26, 30), (200, 96, 40)
CELL_DARK, CELL_LIT = np.array([26, 28, 32]), np.array([214, 150, 50])
GRID, TRAIL = 0xFFFFFF28, 0xF2C94C90
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Axis:
    """An input of a rule base: the probe that holds it, times `scale`, its terms and their corners (n, 4)."""

    name: str
    unit: str
    probe: str
    terms: tuple[str, ...]
    corners: Array
    low: float
    high: float
    scale: float = 1.0


@dataclass(frozen=True)
class Surface:
    """What a rule base answers: `values` (rate points, error points), evenly over both inputs."""

    name: str
    unit: str
    error: Axis
    rate: Axis
    rules: tuple[tuple[str, ...], ...]
    product: bool
    values: Array

    @property
    def path(self) -> str:
        """Its place in a recording."""
        return self.name.lower().replace(" ", "_")


@dataclass(frozen=True)
class LawPicture:
    """A law as it is shown: its title, charts of its probes, and its rule bases, if it has any."""

    process: str
    title: str
    charts: tuple[Chart, ...]
    surfaces: tuple[Surface, ...]

    @classmethod
    def read(cls, table: Any) -> LawPicture | None:
        """From a recording's property `law_picture`; None if there is none. Raises RecordError."""
        if table is None:
            return None
        try:
            process = str(table["process"])
            return cls(
                process=process,
                title=str(table["title"]),
                charts=tuple(_chart(k, each, process) for k, each in enumerate(table["charts"])),
                surfaces=tuple(_surface(each) for each in table["surfaces"]),
            )
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            text = f"{type(error).__name__} {error}"
            raise RecordError(f"properties, law_picture: cannot be drawn: {text}") from None


class LawPage:
    """Draws the surfaces once, and follows the inputs."""

    def __init__(self, picture: LawPicture, sink: RerunSink) -> None:
        self.picture = picture
        self._sink = sink
        self._last_slot = -1
        self._last_cells: NDArray[np.uint8] | None = None
        self._trail = np.empty((0, 2))
        self._stride = 1

    @property
    def rules(self) -> tuple[int, int] | None:
        """Rows and columns of the rules' picture; None for a law without rules."""
        surfaces = self.picture.surfaces
        return (len(surfaces[0].rate.terms), len(surfaces[0].error.terms)) if surfaces else None

    def draw(self) -> None:
        """Log what does not move."""
        for surface in self.picture.surfaces:
            self._draw_surface(surface)
        if self.picture.surfaces:
            self._draw_rules()

    def follow(self, instants: Instants, probes: Mapping[str, Array]) -> None:
        """Log the operating point and the strengths of the rules; several times a second."""
        if not self.picture.surfaces:
            return
        surface = self.picture.surfaces[0]
        if surface.error.probe not in probes or surface.rate.probe not in probes:
            return
        slots = instants.bus_ns // (1_000_000_000 // MOST_ROWS_PER_S)
        rows = np.flatnonzero(np.diff(slots, prepend=self._last_slot) != 0)
        if not len(rows):
            return
        self._last_slot = int(slots[-1])
        error = probes[surface.error.probe][rows] * surface.error.scale
        rate = probes[surface.rate.probe][rows] * surface.rate.scale
        known = np.isfinite(error) & np.isfinite(rate)
        rows, error, rate = rows[known], error[known], rate[known]
        if not len(rows):
            return
        places = np.column_stack((_across(surface.error, error), _up(surface.rate, rate)))
        at = instants.take(rows)
        if not len(self._trail):
            at = at.from_start()
        for each in self.picture.surfaces:
            self._sink.moving_points(f"/law/{each.path}/point", at, places, WHITE, 4.5)
        self._extend_trail(places)
        self._light(at, rule_strengths(surface, error, rate))

    def redraw(self) -> None:
        """Replace the trail of the operating point by what is known now."""
        if len(self._trail) > 1:
            for surface in self.picture.surfaces:
                self._sink.drawing(f"/law/{surface.path}/trail", [self._trail], TRAIL, 1.0)

    def _extend_trail(self, places: Array) -> None:
        self._trail = np.concatenate((self._trail, places[:: self._stride]))
        while len(self._trail) > TRAIL_POINTS:
            self._trail = self._trail[::2]
            self._stride *= 2

    def _light(self, instants: Instants, strengths: Array) -> None:
        """Cells as bright as their rules are strong, in sixteen steps; only when they have changed."""
        steps = np.rint(strengths[:, ::-1, :] * 15).astype(np.uint8)  # rates upwards
        before = steps[:1] ^ 1 if self._last_cells is None else self._last_cells[None]
        changed = np.flatnonzero(np.any(np.diff(np.concatenate((before, steps)), axis=0) != 0, axis=(1, 2)))
        self._last_cells = steps[-1]
        if len(changed):
            share = steps[changed][..., None] / 15.0
            pixels = np.rint(CELL_DARK + share * (CELL_LIT - CELL_DARK)).astype(np.uint8)
            self._sink.moving_image("/law_rules/cells", instants.take(changed), pixels)

    def _draw_surface(self, surface: Surface) -> None:
        entity, size = f"/law/{surface.path}", SURFACE
        self._sink.image(f"{entity}/surface", _heat(surface.values, size))
        grid = []
        for peak in _peaks(surface.error):
            x = float(_across(surface.error, np.array([peak]))[0])
            grid.append(np.array([[x, 0.0], [x, size]]))
        for peak in _peaks(surface.rate):
            y = float(_up(surface.rate, np.array([peak]))[0])
            grid.append(np.array([[0.0, y], [size, y]]))
        self._sink.drawing(f"{entity}/peaks", grid, GRID, 1.0)
        places, texts = [], []
        for value, x in ((surface.error.low, 0.0), (0.0, 0.5), (surface.error.high, 1.0)):
            places.append([x * size, size + 8.0])
            texts.append(f"{value:.3g}")
        for value, y in ((surface.rate.low, 1.0), (0.0, 0.5), (surface.rate.high, 0.0)):
            places.append([-16.0, y * size - 4.0])
            texts.append(f"{value:.3g}")
        self._sink.labels(f"{entity}/ticks", np.array(places), texts, GREY)
        names = [_titled(surface.error), _titled(surface.rate)]
        self._sink.labels(
            f"{entity}/names", np.array([[0.5 * size, size + 24.0], [20.0, -22.0]]), names, WHITE
        )

    def _draw_rules(self) -> None:
        first = self.picture.surfaces[0]
        columns, rows = len(first.error.terms), len(first.rate.terms)
        self._sink.image("/law_rules/cells", np.full((rows, columns, 3), CELL_DARK, np.uint8), moves=True)
        # A pixel of the picture is a cell: what lies on it is given in cells.
        centres = [[j + 0.5, rows - i - 0.5 - 0.12] for i in range(rows) for j in range(columns)]
        cells = [cell for row in first.rules for cell in row]  # of the first one: three do not fit
        self._sink.labels("/law_rules/then", np.array(centres), cells, WHITE)
        heads = [[j + 0.5, -0.35] for j in range(columns)]
        heads += [[-0.35, rows - i - 0.62] for i in range(rows)]
        self._sink.labels("/law_rules/if", np.array(heads), [*first.error.terms, *first.rate.terms], GREY)
        names = np.array([[0.5 * columns, -0.75], [-0.8, 0.5 * rows - 0.12]])
        self._sink.labels("/law_rules/names", names, [first.error.name, first.rate.name], WHITE)


def rule_strengths(surface: Surface, error: Array, rate: Array) -> Array:
    """Strength of every rule at n points, (n, rate terms, error terms); 0 where there is no rule."""
    of_error, of_rate = _grades(surface.error, error), _grades(surface.rate, rate)
    left, right = of_rate[:, :, None], of_error[:, None, :]
    strengths = left * right if surface.product else np.minimum(left, right)
    there = np.array([[cell != "-" for cell in row] for row in surface.rules])
    fired: Array = strengths * there
    return fired


def _grades(axis: Axis, values: Array) -> Array:
    """Grade of every term at n values, (n, terms): trapezoids; beyond the universe as at its end."""
    x = np.clip(values, axis.low, axis.high)[:, None]
    left, top_left, top_right, right = axis.corners.T
    with np.errstate(divide="ignore", invalid="ignore"):
        rising = np.where(top_left > left, (x - left) / (top_left - left), (x >= left) * 1.0)
        falling = np.where(right > top_right, (right - x) / (right - top_right), (x <= right) * 1.0)
    grades: Array = np.clip(np.minimum(rising, falling), 0.0, 1.0)
    return grades


def _heat(values: Array, size: int) -> NDArray[np.uint8]:
    """Blue for negative, orange for positive, dark for zero; the rate upwards. (size, size, 3)."""
    rows = np.linspace(len(values) - 1, 0, size)
    columns = np.linspace(0, values.shape[1] - 1, size)
    lines = np.stack([np.interp(columns, np.arange(values.shape[1]), row) for row in values])
    fine = np.stack([np.interp(rows, np.arange(len(values)), column) for column in lines.T], axis=1)
    largest = float(np.max(np.abs(values))) or 1.0
    share = (fine / largest)[..., None]
    cold, middle, hot = (np.array(color, np.float64) for color in (COLD, MIDDLE, HOT))
    shades = np.where(share < 0, middle - share * (cold - middle), middle + share * (hot - middle))
    return np.rint(shades).astype(np.uint8)


def _across(axis: Axis, values: Array) -> Array:
    return np.clip((values - axis.low) / (axis.high - axis.low), 0.0, 1.0) * SURFACE


def _up(axis: Axis, values: Array) -> Array:
    return SURFACE - _across(axis, values)


def _peaks(axis: Axis) -> list[float]:
    return [float(0.5 * (b + c)) for _, b, c, _ in axis.corners]


def _titled(axis: Axis) -> str:
    return f"{axis.name} [{axis.unit}]"


def _axis(table: Mapping[str, Any]) -> Axis:
    corners = np.array(table["corners"], np.float64)
    terms = tuple(str(term) for term in table["terms"])
    if corners.shape != (len(terms), 4):
        raise ValueError(f"{len(terms)} terms but corners of shape {corners.shape}")
    return Axis(
        str(table["name"]), str(table["unit"]), str(table["probe"]), terms, corners,
        float(table["low"]), float(table["high"]), float(table.get("scale", 1.0)),
    )  # fmt: skip


def _surface(table: Mapping[str, Any]) -> Surface:
    error, rate = _axis(table["error"]), _axis(table["rate"])
    rules = tuple(tuple(str(cell) for cell in row) for row in table["rules"])
    if len(rules) != len(rate.terms) or any(len(row) != len(error.terms) for row in rules):
        raise ValueError("rules: one row for each term of the rate, one cell for each of the error")
    values = np.array(table["values"], np.float64)
    return Surface(
        str(table["name"]), str(table["unit"]), error, rate, rules, bool(table["product"]), values
    )  # fmt: skip


def _chart(number: int, table: Mapping[str, Any], process: str) -> Chart:
    lines: Sequence[Sequence[str]] = table["lines"]
    taken = {probe_color(probe) for probe, _ in lines}
    free = iter(color for color in PALETTE if color not in taken)
    series = []
    for probe, name in lines:
        color = probe_color(probe) or next(free, ORANGE)
        series.append(Series(name, (f"{process}/{probe}",), color))
    levels = tuple(Level(str(name), "", float(value), bool(both)) for name, value, both in table["levels"])
    return Chart(
        f"law_{number}", str(table["title"]), str(table["unit"]), tuple(series), page="Law", levels=levels
    )
