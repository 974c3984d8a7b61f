"""The tables of `hil profile`: the profile asked for, what it is compared with, energy over time."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from controller.profile.solution import Solution
from hil.cli.profile_job import Answer, peak_power_w

SOLVERS = {"ip": "interior point", "dp": "dynamic programming"}
J_PER_KWH = 3.6e6


def report(console: Console, found: Answer, directory: Path, *, recorded: bool) -> None:
    """Print everything, and where the files are."""
    best, journey = found.best, found.journey
    problem = best.problem
    losses = (
        f", efficiencies {problem.traction_efficiency:g} and {problem.regeneration_efficiency:g}"
        if (problem.traction_efficiency, problem.regeneration_efficiency) != (1.0, 0.0)
        else ""
    )
    console.print(
        f"[bold]{journey.line.name}[/bold]: {journey.origin.name} - {journey.destination.name},"
        f" {problem.length_m:.0f} m, train {journey.train.name},"
        f" -{problem.max_deceleration_mps2:.3g} to +{problem.max_acceleration_mps2:.3g} m/s2{losses}",
        highlight=False,
        soft_wrap=True,
    )
    console.print(_profiles(found))
    console.print(
        f"\nnet {best.net_j / J_PER_KWH:.3f} kWh; peak at the rim {max(best.force_n) / 1e3:.1f} kN"
        f" and {peak_power_w(best) / 1e6:.2f} MW,"
        f" top speed {max(best.speed_mps) * 3.6:.1f} km/h;"
        f" least time {best.min_time_s:.3f} s; {problem.stages} stages,"
        f" {SOLVERS.get(best.solver, best.solver)}, {best.iterations} iterations",
        highlight=False,
        soft_wrap=True,
    )
    console.print()
    console.print(_trade_off(found))
    console.print()
    files = ["profile.png", "trade_off.png", "profile.csv", *(["run.rrd"] if recorded else [])]
    console.print(f"results: {directory}/ ({', '.join(files)})", highlight=False, soft_wrap=True)


def _profiles(found: Answer) -> Table:
    table = Table(
        "profile",
        "time s",
        "traction",
        "braked",
        "regen.",
        "net",
        "saves",
        "solved",
        title="MJ at the wheel rim, net at the line",
        title_justify="left",
        box=None,
        pad_edge=False,
    )
    for column in table.columns[1:]:
        column.justify = "right"
        column.no_wrap = True
    best = found.best
    rows = {f"[bold]optimal, {best.solver}[/bold]": best}
    for name, other in found.others.items():
        rows[f"optimal, {name}" if name in SOLVERS else name] = other
    for name, solution in rows.items():
        table.add_row(
            name,
            f"{solution.trip_time_s:.3f}",
            *(
                f"{joule / 1e6:.3f}"
                for joule in (solution.traction_j, solution.braked_j, solution.regenerated_j, solution.net_j)
            ),
            "" if solution is best else saving(best, solution),
            f"{solution.solve_time_s * 1e3:.1f} ms" if solution.solver in SOLVERS else "",
        )
    return table


def saving(best: Solution, other: Solution) -> str:
    """How much less net energy the best takes than another: per cent of the other, or kWh.

    Where one gives back more than it takes, a share of it would say nothing.
    """
    if other.net_j <= 0.0 or best.net_j <= 0.0:
        return f"{(other.net_j - best.net_j) / J_PER_KWH:.2f} kWh"
    percent = 100.0 * (1.0 - best.net_j / other.net_j)
    return f"{percent:.1f} %" if abs(percent) >= 0.05 else f"{percent:+.3f} %"


def _trade_off(found: Answer) -> Table:
    table = Table(
        "time s",
        "above least",
        "net MJ",
        "net kWh",
        "saves",
        "1 s more saves",
        title="energy over trip time",
        title_justify="left",
        box=None,
        pad_edge=False,
    )
    for column in table.columns:
        column.justify = "right"
    for solution in found.curve:
        table.add_row(
            f"{solution.trip_time_s:.2f}",
            f"{100.0 * (solution.trip_time_s / found.fastest.trip_time_s - 1.0):.1f} %",
            f"{solution.net_j / 1e6:.3f}",
            f"{solution.net_j / J_PER_KWH:.3f}",
            "" if solution is found.fastest else saving(solution, found.fastest),
            "" if solution is found.fastest else f"{solution.multiplier_w / J_PER_KWH:.4f} kWh",
            style="bold" if solution is found.best else None,
        )
    return table
