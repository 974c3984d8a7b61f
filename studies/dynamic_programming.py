"""The DP paper: the energy-optimal profile Cat Linh - La Thanh, both directions.

Tables 1 and 2 and figures 3 to 8 of Tran Van K. et al., Transport and Communications Science Journal
72(3), 2021, pp. 317-329, doi:10.47869/tcsj.72.3.7. Its problem: a point mass, acceleration from -1.4 to
+1.1 m/s2 as the control, 1000 stages of 0.931 m, 78 s there and 83 s back. Solved here by dynamic programming
and by the interior point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controller.profile.no_coasting import accelerate_cruise_brake
from controller.profile.problem import Infeasible, Problem
from controller.profile.solution import Solution
from controller.profile.solve import fastest, solve
from hil.railway import Line, Train, load_line, load_train
from hil.railway.library import find_line, find_train
from hil.railway.resistance import n_to_specific
from studies.dynamic_programming_figures import Direction, figures
from studies.study import Progress, Study, silent
from studies.table import Row, Tolerance

STEP_M = 0.931
"""The paper's distance step: 1000 stages."""
RANGES_MPS2 = ((1.4, 1.1), (1.2, 1.0), (1.0, 1.0), (1.0, 0.9))
"""Braking and acceleration of the four profiles beside figure 8, whose own ranges the text does not print."""


@dataclass(frozen=True)
class Printed:
    """What the paper prints of one direction."""

    time_s: float
    trip_time_s: float
    end_speed_error_mps: float
    solve_time_s: float
    energy_kj: float


PRINTED = {
    "Cat Linh - La Thanh": Printed(78.0, 78.14, 0.0807, 8.1715, 341.677),
    "La Thanh - Cat Linh": Printed(83.0, 83.12, 0.0212, 8.5531, 445.018),
}


def run(progress: Progress = silent) -> Study:
    """Solve both directions with both solvers, and the acceleration ranges of figure 8."""
    train = load_train(find_train("cat_linh_4car"))
    progress("Cat Linh - La Thanh", 0.0)
    there = _direction("Cat Linh - La Thanh", load_line(find_line("cat_linh_la_thanh")), train)
    progress("La Thanh - Cat Linh", 0.4)
    back = _direction("La Thanh - Cat Linh", load_line(find_line("la_thanh_cat_linh")), train)
    progress("acceleration ranges", 0.8)
    ranges = _ranges(there.problem)
    rows = [
        *_table_1(there, train),
        *_direction_rows(there),
        *_direction_rows(back),
        *_energy_order(there, back),
        *_range_rows(there.problem, ranges),
    ]
    progress("done", 1.0)
    return Study(
        name="dynamic_programming",
        title="Energy-optimal speed profile by dynamic programming",
        paper="Tran Van K. et al. 2021, doi:10.47869/tcsj.72.3.7",
        rows=rows,
        contradictions=_contradictions(there, back),
        assumptions=ASSUMPTIONS,
        figures=figures(there, back, ranges),
    )


def net_work_without_g_kj(line: Line, train: Train, solution: Solution) -> float:
    """Davis and gradient work [kJ] of a profile, not clipped at zero, with the factor g = 9.81 left out.

    Kinetic energy cancels from standstill to standstill. No curve resistance. This is what comes nearest to
    the paper's energies (worked out here; the paper does not say it).
    """
    problem = solution.problem
    step = np.diff(problem.position_m)
    middle = 0.5 * (problem.position_m[1:] + problem.position_m[:-1])
    mean = 0.5 * (solution.speed_mps[1:] + solution.speed_mps[:-1])
    davis = np.array([n_to_specific(train.running_resistance_n(float(v)), train.mass_kg) for v in mean])
    grade = np.array([line.gradient_permille(float(x)) for x in middle])
    return float(np.sum((davis + grade) * step)) * train.mass_kg * 1e-3 / 1e3


def _direction(name: str, line: Line, train: Train) -> Direction:
    printed = PRINTED[name]
    problem = Problem.of_line(
        line, train, 0.0, 931.0, printed.time_s, train_length_m=0.0, max_step_m=STEP_M,
        max_acceleration_mps2=1.1, max_deceleration_mps2=1.4,
    )  # fmt: skip
    for solver in ("dp", "ip"):  # loads the compiled code; the second time is the solver's own
        solve(problem, solver)
    dp, ip = solve(problem, "dp"), solve(problem, "ip")
    late = solve(problem.with_time(printed.trip_time_s), "ip")
    return Direction(
        name=name,
        line=line,
        train=train,
        problem=problem,
        dp=dp,
        ip=ip,
        plain=accelerate_cruise_brake(problem),
        net_work_without_g_kj=net_work_without_g_kj(line, train, late),
    )


def _ranges(problem: Problem) -> dict[tuple[float, float], Solution]:
    found = {}
    for braking, acceleration in RANGES_MPS2:
        limited = replace(problem, max_acceleration_mps2=acceleration, max_deceleration_mps2=braking)
        found[(braking, acceleration)] = solve(limited, "ip")
    return found


def _table_1(there: Direction, train: Train) -> list[Row]:
    group = "Table 1: train and line"
    limits = there.problem.speed_limit_mps
    place = 0.5 * (there.problem.position_m[1:] + there.problem.position_m[:-1])
    return [
        Row("mass with passengers", "t", 142.36, train.effective_mass_kg / 1e3, Tolerance(absolute=0.005),
            "2 x 37.02 t and 2 x 34.16 t; no allowance for rotating parts", group),
        Row("distance", "m", 931.0, there.problem.length_m, Tolerance(absolute=0.5), "", group),
        Row("highest speed", "m/s", 22.0, float(np.max(limits)), Tolerance(absolute=0.05), "", group),
        Row("limit from 180 to 338 m", "m/s", 12.11, float(limits[(place > 180.0) & (place < 338.0)].max()),
            Tolerance(absolute=0.005), "equation 14, R = 300 m", group),
        Row("limit from 550 to 772 m", "m/s", 16.39, float(limits[(place > 550.0) & (place < 772.0)].max()),
            Tolerance(absolute=0.005), "equation 14, R = 550 m", group),
        Row("largest acceleration", "m/s2", 1.1, there.problem.max_acceleration_mps2,
            Tolerance(absolute=0.05), "", group),
        Row("largest deceleration", "m/s2", 1.4, there.problem.max_deceleration_mps2,
            Tolerance(absolute=0.05), "", group),
    ]  # fmt: skip


def _direction_rows(way: Direction) -> list[Row]:
    printed = PRINTED[way.name]
    group = f"Table 2: {way.name}"
    dp, ip = way.dp, way.ip
    over = float(np.max(dp.speed_mps - way.problem.node_limit_mps))
    return [
        Row("timetable met by", "s", printed.time_s, dp.trip_time_s, Tolerance(absolute=0.01),
            f"the paper's profile takes {printed.trip_time_s} s", group),
        Row("error of position", "m", 0.0, float(dp.problem.position_m[-1] - 931.0), Tolerance(absolute=1e-6),
            "", group),
        Row("error of trip time", "s", printed.trip_time_s - printed.time_s, dp.trip_time_s - printed.time_s,
            note="two neighbours of the timetable are blended, so the time is exact", group=group),
        Row("error of end speed", "m/s", printed.end_speed_error_mps, float(dp.speed_mps[-1]),
            note="the last node is standstill", group=group),
        Row("most above the limit", "m/s", 0.0, max(over, 0.0), Tolerance(absolute=1e-6),
            "v^2 is linear between nodes: nowhere above, not only at the nodes", group),
        Row("time of the solver", "s", printed.solve_time_s, dp.solve_time_s,
            group=group,
            note=f"theirs MATLAB on another machine; interior point {ip.solve_time_s * 1e3:.1f} ms"),
        Row("energy consumed", "kJ", printed.energy_kj, dp.traction_j / 1e3, Tolerance(relative=0.01),
            "ours is traction work at the rim; see the contradictions", group),
        Row("traction work, interior point", "kJ", None, ip.traction_j / 1e3, group=group,
            note=f"dynamic programming is {100 * (dp.traction_j / ip.traction_j - 1):+.3f} % from it"),
        Row("braking work", "kJ", None, dp.braked_j / 1e3, group=group,
            note="lost; the paper does not split"),
        Row("net work, nothing lost in braking", "kJ", printed.energy_kj, (dp.traction_j - dp.braked_j) / 1e3,
            Tolerance(relative=0.01), "integral of the force, not clipped at zero", group),
        Row("the same with g = 9.81 left out", "kJ", printed.energy_kj, way.net_work_without_g_kj,
            Tolerance(relative=0.1), "at the paper's trip time, no curve resistance; worked out here", group),
        Row("saved against a plan without coasting", "%", None,
            100.0 * (1.0 - dp.traction_j / way.plain.traction_j), group=group,
            note=f"accelerate, cruise, brake in the same time takes {way.plain.traction_j / 1e6:.2f} MJ"),
        Row("least time", "s", None, fastest(way.problem).trip_time_s, group=group),
    ]  # fmt: skip


def _energy_order(there: Direction, back: Direction) -> list[Row]:
    paper = PRINTED[back.name].energy_kj / PRINTED[there.name].energy_kj
    group = "Energy of the way back over the way there"
    return [
        Row("traction work", "1", paper, back.dp.traction_j / there.dp.traction_j, Tolerance(relative=0.05),
            "the slower run back takes less: it has five more seconds", group),
        Row("net work with g left out", "1", paper, back.net_work_without_g_kj / there.net_work_without_g_kj,
            Tolerance(relative=0.05), "the order of the paper is that of net work", group),
    ]  # fmt: skip


def _range_rows(problem: Problem, ranges: dict[tuple[float, float], Solution]) -> list[Row]:
    group = "Figure 8: ranges of acceleration, 78 s"
    rows = [
        Row(f"traction work, -{braking:g} to +{acceleration:g} m/s2", "kJ", None, found.traction_j / 1e3,
            group=group, note="figure 8 shows speeds only")
        for (braking, acceleration), found in ranges.items()
    ]  # fmt: skip
    try:
        solve(replace(problem, max_acceleration_mps2=0.8, max_deceleration_mps2=1.0), "ip")
    except Infeasible as error:
        rows.append(
            Row("least time, -1 to +0.8 m/s2", "s", None, error.min_time_s, group=group,
                note="78 s cannot be kept any more")
        )  # fmt: skip
    return rows


def _contradictions(there: Direction, back: Direction) -> list[str]:
    kinetic_mj = 0.5 * there.problem.effective_mass_kg * float(np.max(there.dp.speed_mps)) ** 2 / 1e6
    forward, reverse = PRINTED[there.name].energy_kj, PRINTED[back.name].energy_kj
    return [
        f"The printed energies, {forward} and {reverse} kJ, cannot be traction energy: the kinetic energy at "
        f"the profile's top speed alone is {kinetic_mj:.1f} MJ. The optimum of the stated problem is "
        f"{there.dp.traction_j / 1e6:.2f} and {back.dp.traction_j / 1e6:.2f} MJ, "
        f"{there.dp.traction_j / 1e3 / forward:.0f} and "
        f"{back.dp.traction_j / 1e3 / reverse:.0f} times as much.",
        "What comes nearest to them is the net work, in which braking gives everything back, with the factor "
        f"g = 9.81 left out of the resistances: {there.net_work_without_g_kj:.0f} and "
        f"{back.net_work_without_g_kj:.0f} kJ. That is inferred; which details differed cannot be decided.",
        "The paper's run back, five seconds slower, consumes 30 % more. Traction energy orders them the "
        "other way round; net work has the paper's order, for the line rises on the way back.",
        "Equation 4 prints the curve resistance as 3600/R; the standard that it cites has 600/R, and 3600/R "
        "would make R = 300 m a climb of 12 permille.",
        "Figure 2 gives the curve of R = 550 m a length of 172 m; the text limits the speed on 222 m there.",
        "The errors of end speed of table 2, 0.0807 and 0.0212 m/s, mean that the train does not stop.",
    ]


ASSUMPTIONS = (
    "Order and signs of the gradients: figure 2 prints values without signs; this order is one of two that "
    "come near the printed energies.",
    "The stations lie 79.5 m inside the level ends of figure 2, half of its surplus of 159 m each.",
    "Positions of the curves of R = 800 m and R = 2500 m (their lengths are printed); 600/R as resistance.",
    "Starting resistance (3.5 N/kN on roller bearings, in the first metres only) is left out: 4.5 kJ.",
    "The four ranges of figure 8 are not in the text; here they go from the paper's range down to what still "
    "allows 78 s.",
    "The drive of the train file (182 kN, 2750 kW) does not bind: the paper has none.",
)
