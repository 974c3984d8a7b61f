"""Figures 3 to 8 of the DP paper from our solutions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from controller.profile.problem import Problem
from controller.profile.solution import Solution
from hil.railway import Line as RailwayLine
from hil.railway import Train
from hil.railway.resistance import curve_n_per_kn
from studies.figure import Figure, Floats, Line, Panel, Role

POSITION = "position [m]"
RANGE_ROLES: tuple[Role, ...] = ("a", "b", "c", "d")


@dataclass(frozen=True)
class Direction:
    """One direction, solved: by dynamic programming, by the interior point, and without coasting."""

    name: str
    line: RailwayLine
    train: Train
    problem: Problem
    dp: Solution
    ip: Solution
    plain: Solution
    net_work_without_g_kj: float


def figures(
    there: Direction, back: Direction, ranges: Mapping[tuple[float, float], Solution]
) -> list[Figure]:
    """All of them, each named after the paper's figure that it stands beside."""
    return [
        _speed(there, "3"),
        _power(there, "4"),
        _forces(there, "5"),
        _speed(back, "6"),
        _power(back, "7"),
        _ranges(there, ranges),
    ]


def _speed(way: Direction, number: str) -> Figure:
    problem = way.problem
    limit = np.concatenate((problem.speed_limit_mps, problem.speed_limit_mps[-1:]))
    x = problem.position_m
    return Figure(
        name=f"figure_{number}_speed",
        title=f"{way.name}: speed and time",
        axis="position_m",
        x_label=POSITION,
        paper=f"figure {number}",
        panels=[
            Panel(
                "speed",
                "speed [m/s]",
                [
                    Line("limit", "limit", x, limit, step=True),
                    Line("without coasting", "reference", x, way.plain.speed_mps),
                    Line("dynamic programming", "a", x, way.dp.speed_mps),
                    Line("interior point", "b", x, way.ip.speed_mps),
                ],
                y_limits=(0.0, 25.0),
            ),
            Panel("time", "time [s]", [Line("dynamic programming", "a", x, way.dp.time_s)]),
        ],
    )


def _power(way: Direction, number: str) -> Figure:
    x = way.problem.position_m
    return Figure(
        name=f"figure_{number}_power",
        title=f"{way.name}: power at the wheel rim",
        axis="position_m",
        x_label=POSITION,
        paper=f"figure {number}",
        panels=[
            Panel(
                "power",
                "power [kW]",
                [
                    Line("dynamic programming", "a", x, _power_kw(way.dp)),
                    Line("interior point", "b", x, _power_kw(way.ip)),
                ],
            )
        ],
    )


def _forces(way: Direction, number: str) -> Figure:
    problem = way.problem
    x = problem.position_m
    middle = 0.5 * (x[1:] + x[:-1])
    train, line = way.train, way.line
    davis = np.array([train.running_resistance_n(float(v)) for v in way.ip.speed_mps]) / 1e3
    gradient = np.array([train.track_resistance_n(line.gradient_permille(float(p))) for p in middle]) / 1e3
    curve = np.zeros(len(middle))
    for section in line.curves:
        inside = (middle > section.start_m) & (middle < section.end_m)
        specific = curve_n_per_kn(section.radius_m, line.curve_coefficient)
        curve[inside] = train.track_resistance_n(specific) / 1e3
    return Figure(
        name=f"figure_{number}_forces",
        title=f"{way.name}: forces",
        axis="position_m",
        x_label=POSITION,
        paper=f"figure {number}",
        panels=[
            Panel(
                "effort", "force [kN]", [Line("effort at the rim", "b", x, _held(way.ip.force_n) / 1e3, True)]
            ),
            Panel(
                "resistances",
                "force [kN]",
                [
                    Line("running resistance", "a", x, davis),
                    Line("gradient", "c", x, _held(gradient), step=True),
                    Line("curve", "d", x, _held(curve), step=True),
                ],
            ),
        ],
    )


def _ranges(way: Direction, ranges: Mapping[tuple[float, float], Solution]) -> Figure:
    problem = way.problem
    x = problem.position_m
    lines = [
        Line(
            f"-{braking:g} to +{acceleration:g} m/s2: {found.traction_j / 1e6:.2f} MJ",
            role,
            x,
            found.speed_mps,
        )
        for role, ((braking, acceleration), found) in zip(RANGE_ROLES, ranges.items(), strict=True)
    ]
    limit = Line("limit", "limit", x, _held(problem.speed_limit_mps), step=True)
    return Figure(
        name="figure_8_ranges",
        title=f"{way.name}: speed by range of acceleration",
        axis="position_m",
        x_label=POSITION,
        paper="figure 8",
        panels=[Panel("speed", "speed [m/s]", [limit, *lines], y_limits=(0.0, 25.0))],
    )


def _power_kw(solution: Solution) -> Floats:
    return np.asarray(_held(solution.force_n) * solution.speed_mps / 1e3, dtype=np.float64)


def _held(stages: Floats) -> Floats:
    return np.concatenate((stages, stages[-1:]))
