"""Limits and nominal values in the charts: straight lines from the first to the last thing recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.canbus.contract import Contract
from hil.record.charts import conversion
from hil.record.dashboard import Chart, Level
from hil.record.rerun_sink import RerunSink, component_name, with_unit
from hil.record.timelines import Instants

__all__ = ["LEVELS", "LevelLine", "Levels", "known_levels"]

LEVELS = "levels"
UNITS = {
    "mps": "m/s",
    "mps2": "m/s^2",
    "mps3": "m/s^3",
    "m": "m",
    "s": "s",
    "us": "us",
    "ms": "ms",
    "misses": "cycles",
}
NS_PER_MS = 1e6

Known = Mapping[str, tuple[float, str]]


@dataclass(frozen=True)
class LevelLine:
    """A level as it is drawn: in which chart, its name and value there, the column that holds it."""

    chart: str
    name: str
    value: float
    entity: str
    component: str


def known_levels(properties: Mapping[str, Any], contract: Contract) -> dict[str, tuple[float, str]]:
    """What a `Level` can name: value and unit of limits and periods of the run, time-outs of the contract."""
    known: dict[str, tuple[float, str]] = {}
    for kind, key in (("limits", "limits"), ("period", "period_us")):
        table = properties.get(key)
        for name, value in table.items() if isinstance(table, Mapping) else ():
            unit = "us" if kind == "period" else UNITS.get(name.rpartition("_")[2], "")
            if isinstance(value, int | float):
                known[f"{kind}/{name}"] = (float(value), unit)
    for codec in contract.messages.values():
        if codec.timeout_ns is not None:
            known[f"timeout/{codec.name}"] = (codec.timeout_ns / NS_PER_MS, "ms")
    return known


class Levels:
    """Writes the levels of the charts; those whose value nobody told are left out."""

    def __init__(self, charts: Sequence[Chart], known: Known, sink: RerunSink) -> None:
        self.lines: list[LevelLine] = []
        self._sink = sink
        self._values: dict[str, dict[str, float]] = {}
        for chart in charts:
            for level in chart.levels:
                value = _value(level, chart.unit, known)
                if value is not None:
                    self._add(chart, level.name, value)
                    if level.both:
                        self._add(chart, f"-{level.name}", -value)

    def write(self, instants: Instants) -> None:
        """Draw all levels up to the last of these instants."""
        if len(instants):
            for path, values in self._values.items():
                columns = {name: np.full(len(instants), value) for name, value in values.items()}
                self._sink.columns(f"/{LEVELS}/{path}", LEVELS, instants, columns)

    def _add(self, chart: Chart, name: str, value: float) -> None:
        column = with_unit(name, chart.unit)
        self._values.setdefault(chart.path, {})[column] = value
        line = LevelLine(chart.path, name, value, f"/{LEVELS}/{chart.path}", component_name(LEVELS, column))
        self.lines.append(line)


def _value(level: Level, unit: str, known: Known) -> float | None:
    if not level.source:
        return level.value
    if level.source not in known:
        return None
    value, its_unit = known[level.source]
    factor = conversion(its_unit, unit)
    return None if factor is None else value * factor
