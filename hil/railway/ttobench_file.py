"""The TTOBench JSON format (v1.5) as models, and its units; `ttobench` makes lines and trains of them.

Keys that are not used here may be there: the format is not ours, and grows.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from hil.railway.errors import RailwayDataError
from hil.railway.files import FileModel, choices, one_line


def read_json(path: Path) -> dict[str, Any]:
    """Contents of a JSON file; RailwayDataError if it is missing, unreadable, empty or not a JSON object."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RailwayDataError(f"{path}: no such file") from None
    except OSError as error:
        raise RailwayDataError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise RailwayDataError(f"{path}: not UTF-8 text (byte {error.start})") from None
    except json.JSONDecodeError as error:
        raise RailwayDataError(f"{path}: not valid JSON: {one_line(str(error))}") from None
    if not isinstance(found, dict) or not found:
        raise RailwayDataError(f"{path}: must be a JSON object with the keys of a TTOBench track or train")
    return found


class ForeignModel(FileModel):
    """A table of a format that is not ours: what is not used here may be there."""

    model_config = ConfigDict(
        extra="ignore", frozen=True, strict=True, allow_inf_nan=False, populate_by_name=True
    )


class Metadata(ForeignModel):
    """The table `metadata`."""

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
    library_version: Annotated[str, Field(alias="library version", pattern=r"^TTOBench v1\.")]
    description: str = ""
    created_by: Annotated[str, Field(alias="created by")] = ""


class Titled(ForeignModel):
    """As much of a file as a list of files needs."""

    metadata: Metadata


class Quantity(ForeignModel):
    """A value with its unit."""

    unit: str
    value: float


class Stops(ForeignModel):
    """The table `stops`."""

    unit: str
    values: Annotated[list[float], Field(min_length=2)]


Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
Radius = float | Literal["infinity", "inf", "-infinity", "-inf"]
CurvatureEntry = Annotated[list[Radius], Field(min_length=3, max_length=3)]


class Pairs(ForeignModel):
    """A table of sections with one value each."""

    units: dict[str, str]
    values: Annotated[list[Pair], Field(min_length=1)]


class Curvatures(ForeignModel):
    """The table `curvatures`: position, radius at start, radius at end."""

    units: dict[str, str]
    values: list[CurvatureEntry]


class Tunnels(ForeignModel):
    """The table `tunnels`: position, length, cross section."""

    units: dict[str, str]
    values: list[Triple]


class TrackFile(ForeignModel):
    """A track file."""

    metadata: Metadata
    stops: Stops
    speed_limits: Annotated[Pairs, Field(alias="speed limits")]
    gradients: Pairs | None = None
    curvatures: Curvatures | None = None
    tunnels: Tunnels | None = None


class TrainFile(ForeignModel):
    """A train file."""

    metadata: Metadata
    length: Quantity | None = None
    coaches: Annotated[Quantity | None, Field(alias="num coaches")] = None
    mass: Quantity
    rho: Quantity | None = None
    traction_power: Annotated[Quantity, Field(alias="max traction power")]
    traction_force: Annotated[Quantity, Field(alias="max traction force")]
    regenerative_power: Annotated[Quantity, Field(alias="max reg braking power")]
    regenerative_force: Annotated[Quantity, Field(alias="max reg braking force")]
    pneumatic_force: Annotated[Quantity | None, Field(alias="max pn braking force")] = None
    acceleration: Annotated[Quantity | None, Field(alias="max acceleration")] = None
    deceleration: Annotated[Quantity | None, Field(alias="max deceleration")] = None
    speed: Annotated[Quantity, Field(alias="max speed")]
    r0: Annotated[Quantity, Field(alias="rolling resistance r0")]
    r1: Annotated[Quantity, Field(alias="rolling resistance r1")]
    r2: Annotated[Quantity, Field(alias="rolling resistance r2")]
    traction_efficiency: Annotated[Quantity | None, Field(alias="efficiency traction")] = None
    regeneration_efficiency: Annotated[Quantity | None, Field(alias="efficiency reg brake")] = None


_KMH = 1.0 / 3.6
_UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "km": 1e3},
    "area": {"m^2": 1.0},
    "speed": {"m/s": 1.0, "km/h": _KMH},
    "gradient": {"permil": 1.0, "permille": 1.0, "%": 10.0, "-": 1e3},
    "mass": {"kg": 1.0, "t": 1e3},
    "fraction": {"%": 0.01, "-": 1.0},
    "force": {"N": 1.0, "kN": 1e3},
    "power": {"W": 1.0, "kW": 1e3, "MW": 1e6},
    "acceleration": {"m/s^2": 1.0},
    "force over speed": {"N/(m/s)": 1.0, "N/(km/h)": 3.6, "kN/(m/s)": 1e3, "kN/(km/h)": 3.6e3},
    "force over speed^2": {
        "N/(m/s)^2": 1.0,
        "N/(km/h)^2": 12.96,
        "kN/(m/s)^2": 1e3,
        "kN/(km/h)^2": 12.96e3,
    },
}
"""What one unit of the file is in SI (gradients: in permille), by the kind of quantity."""


def unit_factor(key: str, kind: str, unit: str) -> float:
    """What one of this unit is in SI; RailwayDataError names the key and the units that are known."""
    known = _UNITS[kind]
    if unit not in known:
        raise RailwayDataError(f"{key}: unknown unit {unit!r}; {choices(unit, list(known))}")
    return known[unit]


def column_factor(key: str, units: dict[str, str], name: str, kind: str) -> float:
    """`unit_factor` of one column of a table."""
    if name not in units:
        raise RailwayDataError(f"{key}.units.{name}: is missing")
    return unit_factor(f"{key}.units.{name}", kind, units[name])
