"""The figures of the FSMC study: the paper's Fig. 5 to 22, and the laws over a bus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from studies.figure import Figure, Line, Panel, Role
from studies.fsmc_laws import surface
from studies.fsmc_plant import BRAKE_N, DURATION_S, TRACTION_N, Run, reference_speed

if TYPE_CHECKING:
    from studies.fsmc import BusResult

__all__ = ["figures"]

KMH = 3.6
TIME = "time [s]"
ROLES: Mapping[str, Role] = {"smc": "a", "fsmc": "b", "fsmc_kmh": "d", "fsmc_eso": "c"}
TITLES = {"smc": "SMC", "fsmc": "FSMC"}
CASES = {"nominal": "nominal", "disturbed": "305 t, d = 0.1 sin t"}


def figures(
    runs: Mapping[tuple[str, str], Run], results: Mapping[tuple[str, str], BusResult]
) -> list[Figure]:
    """All figures, from the runs of the paper's experiment and those over the bus."""
    found = [_surface(), _reference()]
    number = 7
    for name in ("smc", "fsmc"):
        for case in ("nominal", "disturbed"):
            found += _paper_figures(number, name, case, runs[name, case])
            number += 4
    return [*found, _bus_error(results), _bus_command(results)]


def _surface() -> Figure:
    """Fig. 5 as slices: a surface hides what the slices show, half authority at sdot = 0."""
    uf = surface()
    s = np.linspace(-0.9, 0.9, 361)
    roles: tuple[Role, ...] = ("a", "b", "c", "d", "e")
    lines = [
        Line(f"sdot = {rate:g} m/s^2", role, s, np.array([uf(x, rate) for x in s]))
        for role, rate in zip(roles, (-0.6, -0.2, 0.0, 0.2, 0.6), strict=True)
    ]
    panel = Panel("Output of the fuzzy part", "uf [1]", lines)
    return Figure("fig05_surface", "Control surface, in slices", "other", "s [m/s]", [panel], "Fig. 5")


def _reference() -> Figure:
    t = np.linspace(0.0, DURATION_S, 901)
    v = KMH * np.array([reference_speed(x) for x in t])
    ends = np.array([0.0, DURATION_S])
    lines = [
        Line("reference", "reference", t, v),
        Line("limit of Table 2", "limit", ends, np.full(2, 80.0)),
    ]
    panel = Panel("Equation 44", "speed [km/h]", lines, None, (0.0, 90.0))
    return Figure("fig06_reference", "Reference speed", "time_s", TIME, [panel], "Fig. 6")


def _paper_figures(number: int, name: str, case: str, run: Run) -> list[Figure]:
    """Tracking, error, sliding surface and force, as the paper numbers them."""
    title, role = f"{TITLES[name]}, {CASES[case]}", ROLES[name]
    error = KMH * run.error_mps
    end = np.array([0.0, DURATION_S])
    limits = [
        Line("most traction, Table 2", "limit", end, np.full(2, TRACTION_N / 1e3)),
        Line("most braking, Table 2", "limit", end, np.full(2, -BRAKE_N / 1e3)),
    ]
    tracking = [
        Line(TITLES[name], role, run.time_s, KMH * run.speed_mps),
        Line("reference", "reference", run.time_s, KMH * run.reference_mps),
    ]
    zoom = (26.0, 26.5)
    near = (run.time_s > zoom[0] - 1.0) & (run.time_s < zoom[1] + 1.0)
    top = float(KMH * np.max(run.reference_mps[near]))
    span = max(0.03, 1.3 * float(np.max(np.abs(error[near]))))
    e = Line("e", role, run.time_s, error)
    s = Line("s", role, run.time_s, run.error_mps)
    u = Line("u", role, run.time_s, run.command_n / 1e3, step=True)
    first = f"fig{number:02d}_{name}_{case}"
    stem = f"_{name}_{case}"
    inside = (20.0, 20.5)
    return [
        Figure(
            f"{first}_tracking",
            f"Tracking: {title}",
            "time_s",
            TIME,
            [
                Panel("Speed", "speed [km/h]", tracking),
                Panel("At the highest speed", "speed [km/h]", tracking, zoom, (top - span, top + span)),
            ],
            f"Fig. {number}",
        ),
        Figure(
            f"fig{number + 1:02d}{stem}_error",
            f"Speed error: {title}",
            "time_s",
            TIME,
            [Panel("e = v - vd", "error [km/h]", [e]), Panel("Half a second", "error [km/h]", [e], inside)],
            f"Fig. {number + 1}",
        ),
        Figure(
            f"fig{number + 2:02d}{stem}_surface",
            f"Sliding surface: {title}",
            "time_s",
            TIME,
            [Panel("s = e", "s [m/s]", [s])],
            f"Fig. {number + 2}",
        ),
        Figure(
            f"fig{number + 3:02d}{stem}_force",
            f"Force: {title}",
            "time_s",
            TIME,
            [
                Panel("Command", "force [kN]", [u, *limits]),
                Panel("Half a second", "force [kN]", [u], inside),
            ],
            f"Fig. {number + 3}",
        ),
    ]


def _bus_error(results: Mapping[tuple[str, str], BusResult]) -> Figure:
    panels = []
    end = np.array([0.0, DURATION_S])
    for case, text in CASES.items():
        lines = [
            Line(results[name, case].title, ROLES[name], run.time_s, KMH * run.error_mps)
            for name in ROLES
            for run in (results[name, case].run,)
        ]
        if case == "disturbed":
            lines.append(Line("the paper's 0.45 km/h", "limit", end, np.full(2, 0.45)))
            lines.append(Line("and -0.45 km/h", "limit", end, np.full(2, -0.45)))
        panels.append(Panel(f"True error, {text}", "error [km/h]", lines, (0.0, DURATION_S)))
    return Figure("bus_error", "Over a bus at 100 Hz: speed error", "time_s", TIME, panels)


def _bus_command(results: Mapping[tuple[str, str], BusResult]) -> Figure:
    panels = []
    for name in ("smc", "fsmc", "fsmc_eso"):
        result = results[name, "disturbed"]
        run = result.run
        lines = [
            Line(result.title, ROLES[name], run.time_s, run.command_n / 1e3, step=True),
            Line("ideal: follows exactly", "ideal", run.time_s, run.ideal_n / 1e3),
        ]
        panels.append(Panel(f"{result.title}, {CASES['disturbed']}", "force [kN]", lines, (20.0, 24.0)))
    return Figure("bus_command", "Over a bus at 100 Hz: command", "time_s", TIME, panels)
