"""The files of `hil profile` for other programs: a table over position, and a Rerun recording."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from hil.cli.profile_job import Answer
from hil.cli.profile_plots import Fine

COLUMNS = (
    "line_position_m",
    "distance_m",
    "time_s",
    "speed_mps",
    "speed_limit_mps",
    "acceleration_mps2",
    "force_n",
    "power_w",
    "gradient_permille",
    "track_resistance_n_per_kn",
    "net_energy_j",
)

DISTANCE = "distance_dm"
UNITS_PER_M = 10.0
"""The viewer's distance is a whole number; a decimetre is finer than the mesh, and can still be read."""


def write_csv(found: Answer, path: Path) -> None:
    """One row a node; stage values (limit to track resistance) hold from the node to the next one.

    `power_w` is the force of the stage that begins at the node times the speed there; `net_energy_j` is the
    energy at the line up to the node.
    """
    best = found.best
    problem = best.problem
    position = found.line_position_m(problem.position_m)
    middle = 0.5 * (position[1:] + position[:-1])
    gradient = [found.direction * found.journey.line.gradient_permille(float(x)) for x in middle]

    def held(values: object) -> list[float]:
        stage = [float(v) for v in np.asarray(values, dtype=np.float64)]
        return [*stage, stage[-1]]

    force = held(best.force_n)
    columns = (
        position,
        problem.position_m,
        best.time_s,
        best.speed_mps,
        held(problem.speed_limit_mps),
        held(best.acceleration_mps2),
        force,
        [f * v for f, v in zip(force, best.speed_mps, strict=True)],
        held(gradient),
        held(problem.track_n_per_kn),
        net_energy_j(found),
    )
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for row in zip(*columns, strict=True):
            writer.writerow([f"{float(value):.9g}" for value in row])


def net_energy_j(found: Answer) -> list[float]:
    """Energy at the line [J] up to each node."""
    best = found.best
    problem = best.problem
    step = np.diff(problem.position_m)
    available = problem.braking.force_n(np.maximum(best.speed_mps[1:], best.speed_mps[:-1]))
    back = np.minimum(np.maximum(-best.force_n, 0.0), available)
    stage = step * (
        np.maximum(best.force_n, 0.0) / problem.traction_efficiency - problem.regeneration_efficiency * back
    )
    return [0.0, *np.cumsum(stage).tolist()]


def write_recording(found: Answer, path: Path) -> None:
    """The profile as a Rerun recording: over time and over distance, the compared ones beside it."""
    import rerun as rr
    import rerun.blueprint as rrb

    profiles = {"optimal": found.best, **{name.replace(" ", "_"): s for name, s in found.others.items()}}
    plots = {
        "speed": "speed [km/h]",
        "gradient": "gradient [permille]",
        "force": "force at the rim [kN]",
        "power": "power at the rim [kW]",
    }
    boundary = rrb.TimeRangeBoundary.absolute
    whole = rrb.TimeRange(
        start=boundary(seq=0), end=boundary(seq=int(np.ceil(found.best.problem.length_m * UNITS_PER_M)))
    )
    views = [
        rrb.TimeSeriesView(origin=f"/{name}", name=title, axis_x=rrb.TimeAxis(view_range=whole))
        for name, title in plots.items()
    ]
    blueprint = rrb.Blueprint(
        rrb.Tabs(
            rrb.Vertical(*views, row_shares=[3.0, 1.0, 1.6, 1.6], name="Profile"),
            rrb.TextDocumentView(origin="/energy", name="Energy"),
        ),
        rrb.TimePanel(state="collapsed", timeline=DISTANCE, play_state="paused"),
        collapse_panels=True,
    )
    recording = rr.RecordingStream("ato_hil_profile")
    recording.save(path, default_blueprint=blueprint)
    for name, solution in profiles.items():
        fine = Fine.of(solution)
        values = {"speed": fine.speed_mps * 3.6, "force": fine.force_n / 1e3, "power": fine.power_w / 1e3}
        if name == "optimal":
            x = found.line_position_m(fine.distance_m)
            line = found.journey.line
            values["gradient"] = np.array([found.direction * line.gradient_permille(float(p)) for p in x])
        times = [
            rr.TimeColumn("trip_time", duration=fine.time_s),
            rr.TimeColumn(DISTANCE, sequence=np.round(fine.distance_m * UNITS_PER_M).astype(np.int64)),
        ]
        for plot, column in values.items():
            recording.send_columns(f"{plot}/{name}", times, rr.Scalars.columns(scalars=column))
        if name == "optimal":
            recording.send_columns("speed/limit", times, rr.Scalars.columns(scalars=fine.limit_mps * 3.6))
    document = rr.TextDocument(_energy_table(found), media_type=rr.MediaType.MARKDOWN)
    recording.log("energy", document, static=True)
    recording.flush()
    recording.disconnect()


def _energy_table(found: Answer) -> str:
    lines = ["| profile | trip time s | traction MJ | braked MJ | net MJ |", "|:---|---:|---:|---:|---:|"]
    for name, solution in (("**optimal**", found.best), *found.others.items()):
        energies = (solution.traction_j, solution.braked_j, solution.net_j)
        cells = " | ".join(f"{joule / 1e6:.3f}" for joule in energies)
        lines.append(f"| {name} | {solution.trip_time_s:.3f} | {cells} |")
    lines += ["", "| trip time s | net MJ |", "|---:|---:|"]
    lines += [f"| {s.trip_time_s:.2f} | {s.net_j / 1e6:.3f} |" for s in found.curve]
    return "\n".join(lines)
