"""A line file: TOML to `Line`. Lengths in m, speeds in km/h, gradients in permille.

TTOBench JSON is read as well, see `ttobench`.

schema = 1
name = "example"
title = "One section"
source = "where the numbers come from"
start_m = 0.0
end_m = 1100.0
default_limit_kmh = 80.0
curve_coefficient = 600.0                 # optional; curve resistance is 600/R N/kN

[[stops]]
name = "A"
position_m = 0.0

[[speed_limits]]                          # all further tables are optional
start_m = 200.0
end_m = 300.0
limit_kmh = 40.0

[[gradients]]                             # start_m, end_m, permille
[[curves]]                                # start_m, end_m, radius_m
[[tunnels]]                               # start_m, end_m, optional resistance_n_per_kn
[[balises]]                               # number, position_m
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from hil.railway.errors import RailwayDataError
from hil.railway.files import SCHEMA, FileModel, read_toml, validate
from hil.railway.line import Balise, Curve, Gradient, Line, SpeedLimit, Stop, Tunnel
from hil.railway.resistance import CURVE_COEFFICIENT, tunnel_n_per_kn
from hil.railway.ttobench import load_ttobench_line

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Text = Annotated[str, Field(min_length=1)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
Schema = Annotated[int, Field(ge=SCHEMA, le=SCHEMA)]
Permille = Annotated[float, Field(ge=-100.0, le=100.0)]  # beyond is no adhesion railway: a slip of units
Radius = Annotated[float, Field(ge=10.0)]


def load_line(path: Path) -> Line:
    """Line of a file, TOML or TTOBench JSON. RailwayDataError: file, key, value and limit in one line."""
    if path.suffix == ".json":
        return load_ttobench_line(path)
    file = validate(LineFile, read_toml(path), path)
    try:
        return Line(
            name=file.name,
            title=file.title,
            source=file.source,
            start_m=file.start_m,
            end_m=file.end_m,
            default_limit_mps=file.default_limit_kmh / 3.6,
            stops=tuple(Stop(s.name, s.position_m) for s in file.stops),
            speed_limits=tuple(SpeedLimit(s.start_m, s.end_m, s.limit_kmh / 3.6) for s in file.speed_limits),
            gradients=tuple(Gradient(g.start_m, g.end_m, g.permille) for g in file.gradients),
            curves=tuple(Curve(c.start_m, c.end_m, c.radius_m) for c in file.curves),
            tunnels=tuple(Tunnel(t.start_m, t.end_m, _tunnel_resistance(t)) for t in file.tunnels),
            balises=tuple(Balise(b.number, b.position_m) for b in file.balises),
            curve_coefficient=file.curve_coefficient,
        )
    except RailwayDataError as error:
        raise RailwayDataError(f"{path}: {error}") from None


class StopEntry(FileModel):
    """An entry of `[[stops]]`."""

    name: Text
    position_m: float


class SpeedLimitEntry(FileModel):
    """An entry of `[[speed_limits]]`."""

    start_m: float
    end_m: float
    limit_kmh: Positive


class GradientEntry(FileModel):
    """An entry of `[[gradients]]`."""

    start_m: float
    end_m: float
    permille: Permille


class CurveEntry(FileModel):
    """An entry of `[[curves]]`."""

    start_m: float
    end_m: float
    radius_m: Radius


class TunnelEntry(FileModel):
    """An entry of `[[tunnels]]`; without a value the resistance follows from the length."""

    start_m: float
    end_m: float
    resistance_n_per_kn: NotNegative | None = None


class BaliseEntry(FileModel):
    """An entry of `[[balises]]`; the number has 16 bits on the bus."""

    number: Annotated[int, Field(ge=0, le=65535)]
    position_m: float


class LineFile(FileModel):
    """A line file."""

    schema_: Annotated[Schema, Field(alias="schema")]
    name: Name
    title: Text
    source: Text
    start_m: float
    end_m: float
    default_limit_kmh: Positive
    curve_coefficient: NotNegative = CURVE_COEFFICIENT
    stops: Annotated[list[StopEntry], Field(min_length=2)]
    speed_limits: list[SpeedLimitEntry] = Field(default_factory=list)
    gradients: list[GradientEntry] = Field(default_factory=list)
    curves: list[CurveEntry] = Field(default_factory=list)
    tunnels: list[TunnelEntry] = Field(default_factory=list)
    balises: list[BaliseEntry] = Field(default_factory=list)


def _tunnel_resistance(tunnel: TunnelEntry) -> float:
    if tunnel.resistance_n_per_kn is None:
        return tunnel_n_per_kn(tunnel.end_m - tunnel.start_m)
    return tunnel.resistance_n_per_kn
