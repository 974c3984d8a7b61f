"""A journey: which train goes from where to where on which line, and in what time.

[journey]
line = "cat_linh_la_thanh"        # a library name, or a path relative to this file
train = "cat_linh_4car"
from = "Cat Linh"
to = "La Thanh"
time_s = 85.0                     # timetable: departure to standstill
seed = 1                          # optional; of everything random in the run
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from hil.railway.errors import RailwayDataError
from hil.railway.files import FileModel, read_toml, validate
from hil.railway.library import find_line, find_train
from hil.railway.line import Line, Stop
from hil.railway.line_file import Positive, Text, load_line
from hil.railway.train import Train
from hil.railway.train_file import load_train


@dataclass(frozen=True)
class Journey:
    """One run from stop to stop."""

    line: Line
    train: Train
    origin: Stop
    destination: Stop
    time_s: float  # timetable: departure to standstill
    seed: int = 1

    @property
    def distance_m(self) -> float:
        """Running distance from stop to stop [m]."""
        return self.destination.position_m - self.origin.position_m

    @property
    def minimum_time_s(self) -> float:
        """Time [s] at the permitted speed all the way; what no train can beat."""
        edges, limits = self.line.speed_limit_profile(self.train.length_m)
        covered = np.clip(edges, self.origin.position_m, self.destination.position_m)
        return float(np.sum(np.diff(covered) / limits))


def load_journey(scenario: Path) -> Journey:
    """Journey of a scenario file, with its line and train.

    Raises RailwayDataError: file, key, value and limit in one line.
    """
    table = validate(JourneyTable, scenario_table(scenario, "journey", required=True), scenario, "journey")
    train = load_train(_found(scenario, "train", table.train))
    line = load_line(_found(scenario, "line", table.line)).capped(train.max_speed_mps)
    origin = _stop(scenario, line, "from", table.from_)
    destination = _stop(scenario, line, "to", table.to)
    if not destination.position_m > origin.position_m:
        raise RailwayDataError(
            f"{scenario}: journey.to: {destination.name!r} at {destination.position_m:g} m must lie beyond "
            f"{origin.name!r} at {origin.position_m:g} m; a line file has one direction of travel"
        )
    journey = Journey(line, train, origin, destination, table.time_s, table.seed)
    if journey.time_s < journey.minimum_time_s:
        raise RailwayDataError(
            f"{scenario}: journey.time_s: {journey.time_s:g} must be at least {journey.minimum_time_s:.1f}, "
            f"the time at the permitted speed all the way"
        )
    return journey


def scenario_table(scenario: Path, name: str, *, required: bool = False) -> dict[str, Any]:
    """One raw table of a scenario file; empty if it is not there, unless it is required."""
    tables = read_toml(scenario)
    if name not in tables:
        if required:
            raise RailwayDataError(f"{scenario}: {name}: is missing; a scenario needs the table [{name}]")
        return {}
    table = tables[name]
    if not isinstance(table, dict):
        raise RailwayDataError(f"{scenario}: {name}: {table!r} must be a table")
    return table


class JourneyTable(FileModel):
    """The table `[journey]`."""

    line: Text
    train: Text
    from_: Annotated[Text, Field(alias="from")]
    to: Text
    time_s: Positive
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1


def _found(scenario: Path, key: str, name_or_path: str) -> Path:
    find = find_line if key == "line" else find_train
    try:
        return find(name_or_path, scenario.parent)
    except RailwayDataError as error:
        raise RailwayDataError(f"{scenario}: journey.{key}: {error}") from None


def _stop(scenario: Path, line: Line, key: str, name: str) -> Stop:
    try:
        return line.stop(name)
    except RailwayDataError as error:
        raise RailwayDataError(f"{scenario}: journey.{key}: {error}") from None
