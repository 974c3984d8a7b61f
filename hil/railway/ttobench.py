"""TTOBench JSON (v1.5): tracks to `Line`, trains to `Train`.

Format: D. Kouzoupis, I. Pendharkar and F. Corman, Operations Research Forum 4, 67 (2023),
doi:10.1007/s43069-023-00248-x, and the README files of that library. Stops are named by their number,
from 1; sections begin at their position and last to the next one.

What the format leaves out, or leaves open, is taken as follows:

- a train without `length` has 25 m for each of its `num coaches`, or is 1 m long, as good as a point;
- without `rho` nothing rotates; without efficiencies they are 1 and 0;
- without `max acceleration` and `max deceleration`: what the forces give to the mass on level track;
- `max pn braking force` 0 or not there: no friction brake in service; in a run, emergency and holding
  brake are friction brakes all the same, for 1.2 m/s^2 and for 40 permille;
- drives answer with 0.4 s lag, 0.1 s dead time and 1.0 m/s^3; comfortable is a jerk of 0.7 m/s^3;
- curve resistance is `CURVE_COEFFICIENT`/R; the curvature of a transition curve is linear in the distance
  and taken in steps of at most `TRANSITION_STEP_M`;
- tunnel resistance follows from the tunnel's length (`tunnel_n_per_kn`); the train's coefficients over
  speed and cross section are not used, nor are ETCS braking data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from hil.railway.errors import RailwayDataError
from hil.railway.files import validate
from hil.railway.line import Curve, Gradient, Line, SpeedLimit, Stop, Tunnel
from hil.railway.resistance import GRAVITY_MPS2, tunnel_n_per_kn
from hil.railway.train import (
    DavisCoefficients,
    EffortCurve,
    ElectrodynamicBrake,
    PneumaticBrake,
    TractionDrive,
    Train,
)
from hil.railway.ttobench_file import (
    Curvatures,
    Pairs,
    Quantity,
    Radius,
    Titled,
    TrackFile,
    TrainFile,
    Tunnels,
    column_factor,
    read_json,
    unit_factor,
)

TRANSITION_STEP_M = 25.0
"""Longest piece of a transition curve that counts as one radius."""

COACH_M = 25.0
POINT_M = 1.0  # a plant that spreads its mass needs some length
EMERGENCY_MPS2 = 1.2
HOLDING_PERMILLE = 40.0
LAG_S = 0.4
FRICTION_LAG_S = 0.6
DEAD_TIME_S = 0.1
DRIVE_JERK_MPS3 = 1.0
COMFORT_JERK_MPS3 = 0.7
FADE_START_MPS = 0.2  # the format's brakes work down to standstill; the last centimetres hold by friction


def load_ttobench_line(path: Path) -> Line:
    """Line of a TTOBench track file. RailwayDataError: file, key, value and limit in one line."""
    track = validate(TrackFile, read_json(path), path)
    try:
        return _line(track)
    except RailwayDataError as error:
        raise RailwayDataError(f"{path}: {error}") from None


def load_ttobench_train(path: Path) -> Train:
    """Train of a TTOBench train file. RailwayDataError: file, key, value and limit in one line."""
    file = validate(TrainFile, read_json(path), path)
    try:
        return _train(file)
    except RailwayDataError as error:
        raise RailwayDataError(f"{path}: {error}") from None


def ttobench_title(path: Path) -> str:
    """What a list shows of a file: its description, or where it comes from."""
    metadata = validate(Titled, read_json(path), path).metadata
    return metadata.description or f"{metadata.library_version}, {metadata.created_by or 'see its README'}"


_ABOVE_ZERO = math.ulp(0.0)


def _si(file: TrainFile, field: str, kind: str, default: float, *, least: float = -math.inf) -> float:
    quantity: Quantity | None = getattr(file, field)
    if quantity is None:
        return default
    key = TrainFile.model_fields[field].alias or field
    value: float = quantity.value * unit_factor(f"{key}.unit", kind, quantity.unit)
    if value < least or (value == 0.0 and least > 0.0):
        what = "greater than 0" if least > 0.0 else f"at least {least:g}"
        raise RailwayDataError(f"{key}.value: {quantity.value:g} must be {what}")
    return value


def _line(track: TrackFile) -> Line:
    metre = unit_factor("stops.unit", "length", track.stops.unit)
    stops = [value * metre for value in track.stops.values]
    if stops[0] != 0.0:
        raise RailwayDataError(f"stops.values#1: {stops[0]:g} must be 0")
    _ascending("stops", stops)
    end_m = stops[-1]
    metadata = track.metadata
    limits = list(_sections("speed limits", track.speed_limits, "velocity", "speed", end_m))
    for number, (_, _, limit) in enumerate(limits, 1):
        if not limit > 0.0:
            raise RailwayDataError(f"speed limits.values#{number}: {limit:g} must be greater than 0")
    gradients = (
        []
        if track.gradients is None
        else _sections("gradients", track.gradients, "slope", "gradient", end_m, checked=_gradient)
    )
    return Line(
        name=metadata.id,
        title=metadata.description or f"{metadata.library_version} track",
        source=f"{metadata.library_version}, {metadata.created_by}, doi:10.1007/s43069-023-00248-x",
        start_m=0.0,
        end_m=end_m,
        default_limit_mps=max(limit for _, _, limit in limits),
        stops=tuple(Stop(str(number), position) for number, position in enumerate(stops, 1)),
        speed_limits=tuple(SpeedLimit(*section) for section in limits),
        gradients=tuple(Gradient(*section) for section in gradients if section[2] != 0.0),
        curves=tuple(_curves(track.curvatures, end_m)),
        tunnels=tuple(_tunnels(track.tunnels, end_m)),
    )


def _ascending(key: str, positions: Sequence[float]) -> None:
    for number, (before, after) in enumerate(pairwise(positions), 2):
        if not after > before:
            raise RailwayDataError(
                f"{key}.values#{number}: position {after:g} must be greater than {before:g}, the one before"
            )


def _gradient(key: str, permille: float) -> None:
    if abs(permille) > 100.0:
        raise RailwayDataError(f"{key}: {permille:g} permille must be from -100 to 100")


def _section_ends(key: str, starts: Sequence[float], end_m: float) -> list[float]:
    _ascending(key, starts)
    if starts and starts[0] != 0.0:
        raise RailwayDataError(f"{key}.values#1: position {starts[0]:g} must be 0")
    if starts and not starts[-1] < end_m:
        raise RailwayDataError(
            f"{key}.values#{len(starts)}: position {starts[-1]:g} must be less than {end_m:g}, the last stop"
        )
    return [*starts[1:], end_m]


def _sections(
    key: str,
    table: Pairs,
    column: str,
    kind: str,
    end_m: float,
    *,
    checked: Callable[[str, float], None] | None = None,
) -> Iterator[tuple[float, float, float]]:
    metre = column_factor(key, table.units, "position", "length")
    factor = column_factor(key, table.units, column, kind)
    starts = [position * metre for position, _ in table.values]
    ends = _section_ends(key, starts, end_m)
    for number, (start, end, (_, value)) in enumerate(zip(starts, ends, table.values, strict=True), 1):
        if checked is not None:
            checked(f"{key}.values#{number}", value * factor)
        yield start, end, value * factor


def _curves(table: Curvatures | None, end_m: float) -> Iterator[Curve]:
    """Curves of constant radius; a transition as pieces of its mean curvature."""
    if table is None:
        return
    key = "curvatures"
    metre = column_factor(key, table.units, "position", "length")
    at_start = column_factor(key, table.units, "radius at start", "length")
    at_end = column_factor(key, table.units, "radius at end", "length")
    starts = [float(entry[0]) * metre for entry in table.values]
    ends = _section_ends(key, starts, end_m)
    for number, (start, end, entry) in enumerate(zip(starts, ends, table.values, strict=True), 1):
        first = _curvature(f"{key}.values#{number}", entry[1], at_start)
        last = _curvature(f"{key}.values#{number}", entry[2], at_end)
        pieces = 1 if first == last else max(2, math.ceil((end - start) / TRANSITION_STEP_M))
        for piece in range(pieces):
            left, right = piece / pieces, (piece + 1) / pieces
            mean = _mean_absolute(first + left * (last - first), first + right * (last - first))
            if mean > 0.0:
                yield Curve(start + left * (end - start), start + right * (end - start), 1.0 / mean)


def _curvature(key: str, radius: Radius, metre: float) -> float:
    radius_m = float(radius) * metre  # "infinity" is a float to Python
    if abs(radius_m) < 10.0:
        raise RailwayDataError(f"{key}: radius {radius_m:g} m must be at least 10 m on either side")
    return 0.0 if math.isinf(radius_m) else 1.0 / radius_m


def _mean_absolute(first: float, last: float) -> float:
    """Mean of |k| where k goes linearly from `first` to `last`."""
    if first * last >= 0.0:
        return 0.5 * (abs(first) + abs(last))
    return 0.5 * (first * first + last * last) / (abs(first) + abs(last))


def _tunnels(table: Tunnels | None, end_m: float) -> Iterator[Tunnel]:
    if table is None:
        return
    metre = column_factor("tunnels", table.units, "position", "length")
    length_factor = column_factor("tunnels", table.units, "length", "length")
    for number, (position, length, _) in enumerate(table.values, 1):
        start, length_m = position * metre, length * length_factor
        if length_m < 0.0 or start + length_m > end_m:
            raise RailwayDataError(
                f"tunnels.values#{number}: {start:g} m plus {length_m:g} m must not lie beyond {end_m:g} m, "
                f"the last stop"
            )
        if length_m > 0.0:
            yield Tunnel(start, start + length_m, tunnel_n_per_kn(length_m))


def _train(file: TrainFile) -> Train:
    mass_kg = _si(file, "mass", "mass", 0.0, least=_ABOVE_ZERO)
    rotating = _si(file, "rho", "fraction", 0.0, least=0.0)
    if rotating >= 1.0:  # as the factor on the mass, 1.06, instead of what is added, 6 %
        rotating -= 1.0
    if rotating > 0.5:
        raise RailwayDataError(f"rho.value: {rotating:g} of the mass must be at most 0.5")
    effective_kg = mass_kg * (1.0 + rotating)
    traction_n = _si(file, "traction_force", "force", 0.0, least=_ABOVE_ZERO)
    regenerative_n = _si(file, "regenerative_force", "force", 0.0, least=_ABOVE_ZERO)
    friction_n = _si(file, "pneumatic_force", "force", 0.0, least=0.0)
    traction = EffortCurve(traction_n, _si(file, "traction_power", "power", 0.0, least=_ABOVE_ZERO))
    braking = EffortCurve(regenerative_n, _si(file, "regenerative_power", "power", 0.0, least=_ABOVE_ZERO))
    level_mps2 = (regenerative_n + friction_n) / effective_kg
    metadata = file.metadata
    return Train(
        name=metadata.id,
        title=metadata.description or f"{metadata.library_version} train",
        source=f"{metadata.library_version}, {metadata.created_by}, doi:10.1007/s43069-023-00248-x",
        mass_kg=mass_kg,
        rotating_mass_factor=rotating,
        length_m=_si(file, "length", "length", _default_length_m(file), least=_ABOVE_ZERO),
        davis=DavisCoefficients(
            _si(file, "r0", "force", 0.0, least=0.0),
            _si(file, "r1", "force over speed", 0.0, least=0.0),
            _si(file, "r2", "force over speed^2", 0.0, least=0.0),
        ),
        traction=TractionDrive(traction, LAG_S, DEAD_TIME_S, DRIVE_JERK_MPS3),
        electrodynamic=ElectrodynamicBrake(braking, LAG_S, DEAD_TIME_S, DRIVE_JERK_MPS3, FADE_START_MPS, 0.0),
        pneumatic=PneumaticBrake(
            friction_n,
            FRICTION_LAG_S,
            DEAD_TIME_S,
            max(friction_n, EMERGENCY_MPS2 * effective_kg),
            HOLDING_PERMILLE * 1e-3 * GRAVITY_MPS2 * mass_kg,
        ),
        max_acceleration_mps2=_si(
            file, "acceleration", "acceleration", traction_n / effective_kg, least=_ABOVE_ZERO
        ),
        max_braking_mps2=_si(file, "deceleration", "acceleration", level_mps2, least=_ABOVE_ZERO),
        comfort_jerk_mps3=COMFORT_JERK_MPS3,
        max_speed_mps=_si(file, "speed", "speed", math.inf, least=_ABOVE_ZERO),
        traction_efficiency=_si(file, "traction_efficiency", "fraction", 1.0, least=_ABOVE_ZERO),
        regeneration_efficiency=_si(file, "regeneration_efficiency", "fraction", 0.0, least=0.0),
    )


def _default_length_m(file: TrainFile) -> float:
    return POINT_M if file.coaches is None else COACH_M * file.coaches.value
