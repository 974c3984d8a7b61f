"""`hil profile`: the energy-optimal speed profile between two stops."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from controller.profile.mesh import DEFAULT_STEP_M
from hil.bench.directory import new_run_directory
from hil.cli.profile_job import (
    Answer,
    Options,
    answer,
    default_name,
    load,
    peak_power_w,
    problem_of,
    solver_of,
)
from hil.record.viewer import display_missing


def profile(
    line: Annotated[
        str,
        typer.Argument(metavar="LINE", help="A shipped line (hil list), a TOML file or a TTOBench track."),
    ],
    origin: Annotated[str, typer.Argument(metavar="FROM", help="Stop: its name or its number, from 1.")],
    destination: Annotated[str, typer.Argument(metavar="TO", help="Stop; before FROM: the reverse journey.")],
    time_s: Annotated[float | None, typer.Option("--time", metavar="S", help="Trip time, seconds.")] = None,
    train: Annotated[
        str | None,
        typer.Option(
            help="A shipped train, a TOML file or a TTOBench train (default: the one of the line's scenario)."
        ),
    ] = None,
    solver: Annotated[
        str,
        typer.Option(
            metavar="auto|ip|dp",
            help="Interior point, dynamic programming, or the first and else the second.",
        ),
    ] = "auto",
    compare: Annotated[
        bool, typer.Option("--compare", help="Both solvers, and a plan without coasting, beside it.")
    ] = False,
    max_acceleration: Annotated[
        float | None, typer.Option(metavar="M/S2", help="Largest acceleration (default: the train's).")
    ] = None,
    max_deceleration: Annotated[
        float | None,
        typer.Option(metavar="M/S2", help="Largest deceleration, positive (default: the train's)."),
    ] = None,
    traction_efficiency: Annotated[
        float | None, typer.Option(metavar="0..1", help="Wheel rim over line (default: the train's).")
    ] = None,
    regeneration_efficiency: Annotated[
        float | None,
        typer.Option(metavar="0..1", help="Back to the line over braking work (default: the train's)."),
    ] = None,
    train_length: Annotated[
        float, typer.Option(metavar="M", help="Limits and gradients act along it; 0: on the front alone.")
    ] = 0.0,
    max_step: Annotated[float, typer.Option(metavar="M", help="Largest step of the mesh.")] = DEFAULT_STEP_M,
    out: Annotated[
        Path | None, typer.Option(help="Directory of the results (default: runs/<time>-profile-…).")
    ] = None,
    show: Annotated[bool, typer.Option("--view", help="Open it in the Rerun viewer.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> int:
    """Find the speed profile of least energy for a trip time.

    [bold]hil profile cat_linh_la_thanh "Cat Linh" "La Thanh" --time 78 --compare[/bold]

    [bold]hil profile CN_Songjiazhuang_Yizhuang 1 2 --train CN_Beijing_Subway --time 170[/bold]
    """
    console = Console(stderr=as_json)
    options = Options(
        max_acceleration_mps2=max_acceleration,
        max_deceleration_mps2=max_deceleration,
        traction_efficiency=traction_efficiency,
        regeneration_efficiency=regeneration_efficiency,
        train_length_m=train_length,
        max_step_m=max_step,
    )
    journey = load(line, origin, destination, time_s, train)
    problem = problem_of(journey, options)
    with console.status(f"solving {problem.stages} stages (the very first time compiles: some seconds more)"):
        found = answer(journey, problem, solver_of(solver), compare=compare)
    # Only now: bad input is told before the drawing library has been loaded.
    from hil.cli.profile_files import write_csv, write_recording
    from hil.cli.profile_plots import draw_profile, draw_trade_off

    directory = new_run_directory(out, default_name(journey))
    with console.status("drawing"):
        write_csv(found, directory / "profile.csv")
        draw_profile(found, directory / "profile.png")
        draw_trade_off(found, directory / "trade_off.png")
        if show:
            write_recording(found, directory / "run.rrd")
    if as_json:
        typer.echo(json.dumps(document(found, directory), indent=2, allow_nan=False))
    else:
        from hil.cli.profile_tables import report

        report(console, found, directory, recorded=show)
    if show:
        _open(console, directory)
    return 0


def document(found: Answer, directory: Path) -> dict[str, Any]:
    """The JSON document of `--json`: energies at the wheel rim, `net_j` at the line side."""
    best, journey = found.best, found.journey
    return {
        "solver": best.solver,
        "stages": best.problem.stages,
        "trip_time_s": best.trip_time_s,
        "min_time_s": best.min_time_s,
        "solve_time_s": best.solve_time_s,
        "energy": _energy(found, "best"),
        "line": journey.line.name,
        "train": journey.train.name,
        "from": journey.origin.name,
        "to": journey.destination.name,
        "distance_m": best.problem.length_m,
        "traction_efficiency": best.problem.traction_efficiency,
        "regeneration_efficiency": best.problem.regeneration_efficiency,
        "peak_force_n": float(max(best.force_n)),
        "peak_power_w": peak_power_w(best),
        "energy_per_second_w": best.multiplier_w,
        "iterations": best.iterations,
        "compared": {
            name: {
                "trip_time_s": other.trip_time_s,
                "solve_time_s": other.solve_time_s,
                "energy": _energy(found, name),
            }
            for name, other in found.others.items()
        },
        "trade_off": [{"trip_time_s": s.trip_time_s, "net_j": s.net_j} for s in found.curve],
        "directory": str(directory),
    }


def _energy(found: Answer, name: str) -> dict[str, float]:
    solution = found.best if name == "best" else found.others[name]
    return {
        "traction_j": solution.traction_j,
        "regenerated_j": solution.regenerated_j,
        "net_j": solution.net_j,
        "braked_j": solution.braked_j,
    }


def _open(console: Console, directory: Path) -> None:
    if display_missing():
        console.print(
            f"no viewer: there is no display here; use: hil view --web {directory}",
            style="yellow",
            soft_wrap=True,
            highlight=False,
        )
        return
    import subprocess

    from hil.record.viewer import viewer_binary

    subprocess.Popen([str(viewer_binary()), str(directory / "run.rrd")], start_new_session=True)
