"""The charts of the dashboard: finds for every line the column that holds it.

A chart has one unit. A source in another unit gets a second, converted column beside its own.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.canbus.units import si_unit
from hil.record.dashboard import Chart, Series
from hil.record.distance import DistanceChart
from hil.record.rerun_sink import RerunSink, component_name, with_unit
from hil.record.timelines import Instants

__all__ = ["ChartLine", "Charts", "Source", "conversion"]

MM_PER_M = 1000.0
UNIT_SUFFIX = re.compile(r"_(mps|mps2|mps3|m|n|j|w|s|ms|us|ns)$")  # as probes are named: speed_mps


@dataclass(frozen=True)
class Source:
    """A recorded quantity: its entity, the group of its column there, its name and unit."""

    entity: str
    group: str
    name: str
    unit: str


@dataclass(frozen=True)
class ChartLine:
    """A line of a chart and the column that it shows."""

    chart: Chart
    series: Series
    source: Source
    factor: float

    @property
    def column(self) -> str:
        """Name of the column in the chart's unit: its own one, or a converted `speed [km/h]`."""
        if not self.converted:
            return with_unit(self.source.name, self.source.unit)
        name = UNIT_SUFFIX.sub("", self.source.name)
        return with_unit(f"-{name}" if self.series.sign < 0 else name, self.chart.unit)

    @property
    def converted(self) -> bool:
        """Whether the chart needs a column of its own."""
        return self.source.unit != self.chart.unit or self.series.sign < 0

    @property
    def component(self) -> str:
        """The column as Rerun calls it."""
        return component_name(self.source.group, self.column)


class Charts:
    """Chooses the source of every line: the first of its list that exists."""

    def __init__(self, charts: Sequence[Chart], sink: RerunSink) -> None:
        self._charts = charts
        self._sink = sink
        self._sources: dict[str, Source] = {}
        self._lines: dict[str, list[ChartLine]] = {}
        self.distance = {chart.path: DistanceChart(chart) for chart in charts if chart.distance}

    def offer(self, sources: Mapping[str, Source]) -> None:
        """Say what can be plotted, by the names that the dashboard uses."""
        self._sources |= sources
        before, self._lines = self.lines, {}
        for chart in self._charts:
            for series in chart.series:
                self._choose(chart, series)
        for line in before:  # what a better source replaces would be drawn a second time
            if line.chart.distance and line not in self.lines:
                self.distance[line.chart.path].forget(line.series.name)

    @property
    def lines(self) -> list[ChartLine]:
        """All lines that have a source, in the order of the charts."""
        places = {chart.path: place for place, chart in enumerate(self._charts)}
        found = [line for lines in self._lines.values() for line in lines]
        return sorted(found, key=lambda line: (places[line.chart.path], line.chart.series.index(line.series)))

    def take(
        self, name: str, instants: Instants, values: NDArray[np.float64]
    ) -> dict[str, NDArray[np.float64]]:
        """Tell the charts new values of a source; the converted columns to record beside it."""
        extra: dict[str, NDArray[np.float64]] = {}
        for line in self._lines.get(name, ()):
            converted = values * (line.factor * line.series.sign)
            if line.converted:
                extra[line.column] = converted
            if line.chart.distance:
                position_m = instants.position_mm / MM_PER_M
                self.distance[line.chart.path].add(line.series.name, position_m, converted)
        return extra

    def redraw(self) -> None:
        """Replace the charts over distance by what is known now."""
        for chart in self.distance.values():
            chart.draw(self._sink)

    def _choose(self, chart: Chart, series: Series) -> None:
        for name in series.sources:
            source = self._sources.get(name)
            factor = conversion(source.unit, chart.unit) if source is not None else None
            if source is not None and factor is not None:
                self._lines.setdefault(name, []).append(ChartLine(chart, series, source, factor))
                return


def conversion(unit: str, wanted: str) -> float | None:
    """Factor from one unit to another; None when they measure different things."""
    if unit == wanted:
        return 1.0
    try:
        (base, factor), (wanted_base, wanted_factor) = si_unit(unit), si_unit(wanted)
    except KeyError:
        return None
    return float(factor / wanted_factor) if base == wanted_base else None
