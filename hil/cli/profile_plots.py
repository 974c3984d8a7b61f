"""The pictures of `hil profile`: speed, gradient, force and power over distance; energy over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controller.profile.profile import Floats
from controller.profile.solution import Solution
from hil.cli.profile_job import Answer

POINTS_PER_STAGE = 8
"""Between two nodes v^2 is linear in position, so the speed is not: near a stop that can be seen."""
OPTIMAL, LIMIT, GROUND = "#0b62a4", "#c0392b", "#b9a98a"
OTHERS = {"ip": "#e08a00", "dp": "#e08a00", "no coasting": "#7a8b3c", "fastest": "#9aa0a6"}
LABELS = {"ip": "interior point", "dp": "dynamic programming"}


@dataclass(frozen=True)
class Fine:
    """A solution between its nodes too: equal arrays over distance."""

    distance_m: Floats
    time_s: Floats
    speed_mps: Floats
    limit_mps: Floats
    force_n: Floats
    power_w: Floats
    acceleration_mps2: Floats

    @classmethod
    def of(cls, solution: Solution) -> Fine:
        """`POINTS_PER_STAGE` points a stage, both ends included, so that steps are steps."""
        share = np.linspace(0.0, 1.0, POINTS_PER_STAGE)
        x, v, t = solution.problem.position_m, solution.speed_mps, solution.time_s
        step = np.diff(x)
        distance = x[:-1, None] + step[:, None] * share
        speed = np.sqrt(v[:-1, None] ** 2 + np.diff(v**2)[:, None] * share)
        mean = 0.5 * (v[:-1, None] + speed)
        time = t[:-1, None] + np.where(share > 0.0, step[:, None] * share / np.maximum(mean, 1e-12), 0.0)
        stage = [
            np.repeat(values, POINTS_PER_STAGE)
            for values in (solution.problem.speed_limit_mps, solution.force_n, solution.acceleration_mps2)
        ]
        return cls(
            distance.ravel(),
            time.ravel(),
            speed.ravel(),
            stage[0],
            stage[1],
            stage[1] * speed.ravel(),
            stage[2],
        )


def draw_profile(found: Answer, path: Path) -> None:
    """Speed with limits, the ground, force and power over distance, one under the other."""
    figure = Figure(figsize=(11, 10), layout="constrained")
    speed, ground, force, power = figure.subplots(4, 1, sharex=True, height_ratios=(3.0, 1.1, 1.6, 1.6))
    fine = Fine.of(found.best)
    kilometres = found.best.problem.length_m > 5000.0
    unit = 1e3 if kilometres else 1.0
    x = fine.distance_m / unit
    speed.plot(x, fine.limit_mps * 3.6, color=LIMIT, linewidth=1.2, label="speed limit")
    for name, other in reversed(found.others.items()):
        _line(speed, unit, Fine.of(other), name, "speed_mps", 3.6)
        if name != "fastest":
            _line(force, unit, Fine.of(other), name, "force_n", 1e-3)
            _line(power, unit, Fine.of(other), name, "power_w", 1e-3)
    solver = LABELS.get(found.best.solver, found.best.solver)
    speed.plot(x, fine.speed_mps * 3.6, color=OPTIMAL, linewidth=2.0, label=f"optimal, {solver}")
    force.plot(x, fine.force_n / 1e3, color=OPTIMAL, linewidth=1.6)
    power.plot(x, fine.power_w / 1e3, color=OPTIMAL, linewidth=1.6)
    for axes, values in ((force, fine.force_n / 1e3), (power, fine.power_w / 1e3)):
        axes.fill_between(x, 0.0, values, where=values > 0.0, color=OPTIMAL, alpha=0.15, linewidth=0.0)
        axes.fill_between(x, 0.0, values, where=values < 0.0, color=LIMIT, alpha=0.15, linewidth=0.0)
    _ground(found, fine, ground, unit)
    speed.set_ylabel("speed [km/h]")
    speed.set_ylim(0.0, 1.18 * 3.6 * float(np.max(fine.limit_mps)))
    speed.legend(loc="upper center", ncols=5, frameon=False, fontsize=9)
    force.set_ylabel("force at the rim [kN]")
    power.set_ylabel("power at the rim [kW]")
    power.set_xlabel(f"distance from {_stop(found, 0)} [{'km' if kilometres else 'm'}]")
    power.set_xlim(float(x[0]), float(x[-1]))
    for axes in (speed, ground, force, power):
        _tidy(axes)
    best = found.best
    figure.suptitle(
        f"{found.journey.line.name}, {_stop(found, 0)} to {_stop(found, 1)}: {best.trip_time_s:.2f} s, "
        f"{best.net_j / 1e6:.3f} MJ ({best.net_j / 3.6e6:.3f} kWh) net; least time {best.min_time_s:.2f} s"
    )
    figure.savefig(path, dpi=110)


def draw_trade_off(found: Answer, path: Path) -> None:
    """Net energy over trip time, with what was asked for marked."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes: Axes = figure.subplots()
    times = [s.trip_time_s for s in found.curve]
    axes.plot(times, [s.net_j / 3.6e6 for s in found.curve], color=OPTIMAL, marker="o", markersize=4,
              label="optimal")  # fmt: skip
    best = found.best
    axes.plot([best.trip_time_s], [best.net_j / 3.6e6], color=LIMIT, marker="o", markersize=9, linestyle="",
              label=f"asked for: {best.trip_time_s:.2f} s, {best.net_j / 3.6e6:.3f} kWh")  # fmt: skip
    plain = found.others.get("no coasting")
    if plain is not None:
        label = f"no coasting: {plain.net_j / 3.6e6:.3f} kWh"
        axes.plot([plain.trip_time_s], [plain.net_j / 3.6e6], color=OTHERS["no coasting"],
                  marker="s", markersize=7, linestyle="", label=label)  # fmt: skip
    axes.axvline(found.fastest.trip_time_s, color=OTHERS["fastest"], linestyle="--", linewidth=1.0,
                 label=f"least time {found.fastest.trip_time_s:.2f} s")  # fmt: skip
    axes.set_xlabel("trip time [s]")
    axes.set_ylabel("net energy at the line [kWh]")
    axes.set_title(f"{found.journey.line.name}, {_stop(found, 0)} to {_stop(found, 1)}")
    axes.legend(frameon=False)
    _tidy(axes)
    figure.savefig(path, dpi=110)


def _line(axes: Axes, unit: float, fine: Fine, name: str, field: str, factor: float) -> None:
    axes.plot(
        fine.distance_m / unit,
        getattr(fine, field) * factor,
        color=OTHERS[name],
        linewidth=1.2,
        linestyle="--" if name in LABELS else "-",
        label=f"optimal, {LABELS[name]}" if name in LABELS else name,
        zorder=3 if name in LABELS else 1.5,
    )


def _ground(found: Answer, fine: Fine, axes: Axes, unit: float) -> None:
    x = found.line_position_m(fine.distance_m)
    inside = np.where(np.arange(len(x)) % POINTS_PER_STAGE == POINTS_PER_STAGE - 1, -1e-6, 1e-6)
    line = found.journey.line
    gradient = np.array(
        [found.direction * line.gradient_permille(float(p)) for p in x + found.direction * inside]
    )
    resistance = np.repeat(found.best.problem.track_n_per_kn, POINTS_PER_STAGE)
    axes.fill_between(fine.distance_m / unit, 0.0, gradient, color=GROUND, linewidth=0.0, label="gradient")
    axes.plot(fine.distance_m / unit, resistance, color="#5b4a2c", linewidth=1.0,
              label="with curves and tunnels")  # fmt: skip
    axes.set_ylabel("gradient [‰]")
    axes.legend(loc="best", ncols=2, frameon=False, fontsize=8)


def _stop(found: Answer, which: int) -> str:
    stop = (found.journey.origin, found.journey.destination)[which]
    return f"stop {stop.name}" if stop.name.isdigit() else stop.name


def _tidy(axes: Axes) -> None:
    axes.grid(visible=True, color="#e6e6e6", linewidth=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if axes.get_ylim()[0] < 0.0:
        axes.axhline(0.0, color="#808080", linewidth=0.8)
