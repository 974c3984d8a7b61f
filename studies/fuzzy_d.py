"""The Fuzzy-D paper: PID, SpeedT and Fuzzy-D on its 2 km line, and the same controllers on a train.

Nguyen Van Tiem, Transport and Communications Science Journal 71(6), 2020, doi:10.25073/tcsj.71.6.1, section
4.
Its membership functions are drawn without numbers; the set used here was fitted to the paper's nine headline
numbers (seven unknowns), so it is a solution, not necessarily the author's.
"""

from __future__ import annotations

import math

from controller.laws import Law
from hil.railway.resistance import davis_n
from studies.fuzzy_d_figures import figures
from studies.fuzzy_d_laws import TITLES, ideal_derivative_pid, paper_laws, train_laws
from studies.fuzzy_d_plant import (
    DRAG_N_PER_MPS,
    LIMIT_MPS,
    MASS_KG,
    STOP_M,
    Headline,
    Run,
    drive,
    headline,
)
from studies.fuzzy_d_train import TrainRun, braking_distance_m, drive_train, launch, train_data
from studies.study import Progress, Study, silent
from studies.table import Row, Tolerance

__all__ = ["STEPS_S", "paper_runs", "run"]

STEPS_S = {"pid": 1e-3, "speedt": 1e-3, "fuzzy_d": 0.25e-3}
"""Step of each law and of the plant: the paper's Fuzzy-D does not survive 10 ms."""

TEN_PERCENT = 0.1
"""What counts as reproduced: within 10 %, or half of the last digit that the paper prints."""


def paper_runs(progress: Progress = silent) -> dict[str, Run]:
    """The three controllers on the paper's plant."""
    runs = {}
    for name, law in paper_laws().items():

        def watch(position_m: float, what: str = TITLES[name]) -> None:
            progress(what, min(1.0, position_m / STOP_M))

        runs[name] = drive(law, STEPS_S[name], watch=watch)
    return runs


def run(progress: Progress = silent) -> Study:
    """Run the paper's experiment and its controllers on a train."""
    runs = paper_runs(progress)
    progress("the same gains at 100 Hz", 0.0)
    slow = headline(drive(paper_laws()["fuzzy_d"], 0.01, end_m=980.0))
    ideal = headline(drive(ideal_derivative_pid(), STEPS_S["pid"], end_m=980.0))
    trains = _train_runs(progress)
    heads = {name: headline(paper_run) for name, paper_run in runs.items()}
    return Study(
        name="fuzzy_d",
        title="PID, SpeedT and Fuzzy-D on a 2 km line",
        paper="Nguyen Van Tiem 2020, doi:10.25073/tcsj.71.6.1, section 4",
        rows=[*_headlines(heads), *_fragility(slow, ideal), *_physics(heads), *_train(trains)],
        contradictions=CONTRADICTIONS,
        assumptions=ASSUMPTIONS,
        figures=figures(runs, trains),
    )


CONTRADICTIONS = (
    "Fig. 15 and 16 need 3.8, 9.4 and 25 m/s2 on average to reach 15 m/s in 30, 12 and 4.5 m; a train with "
    "steel wheels has 1 to 1.3 m/s2. The controllers are compared with efforts in the ratio 1 : 7 : 68.",
    "The text says that the speed must change about 100 m before the curve and the stop; stop errors of 30, "
    "4.5 and 1 m come out only if the reference drops within some 6 m of the stop itself.",
    "The plant of equation 4 is no train of four cars: 8621 kg are about 1/18 of it, and its drag 822.4 v is "
    "1.43 m/s2 at 15 m/s, some 33 times a train's.",
    "Equation 1 as printed reduces to w1 + vx - v1; meant is w1 + (vx - v1)(w2 - w1)/(v2 - v1).",
    "Equation 3 compares the curve's radius with the train's length; meant is the curve's length.",
    "Davis coefficients 2.965, 0.23, 0.005 are given in N, which would be 7.5 N at 15 m/s; meant is kN.",
    "Gradients of +-6 % would be 0.59 m/s2; equation 3 and Fig. 11 are in N/kN: 6 permille.",
    "4 motors of 190 kW take 160 t to 15 m/s in some 280 m; 4 in each motor car take it there in some 143 m.",
    "The abstract says that the fuzzy part computes the coefficient of the proportional term; equation 6 "
    "uses its output as the control itself.",
)

ASSUMPTIONS = (
    "Membership functions (the paper draws them without numbers): peaks e 6.866, 13.731 m/s; de 1.443, "
    "20.507 m/s2; u 391.20, 399.57, 541.99. Fitted with the ramp's length: 7 unknowns for 9 numbers.",
    "The PID's derivative filter N = 0.524 1/s is not printed: it is what MATLAB's tuner returns beside the "
    "paper's gains. With an ideal derivative the overshoot is 3.1 %, not 9.7 %.",
    "Defuzzification with 101 points (MATLAB's default). The reference depends on position, with ramps of "
    "6.49 m, and de is the rate of the error including the ramp's.",
    "Gradient and curve act as N/kN on the plant's 8621 kg; read as plain newtons they change nothing.",
    "Steps of 1 ms (PID, SpeedT) and 0.25 ms (Fuzzy-D).",
)


def _headlines(heads: dict[str, Headline]) -> list[Row]:
    """Section 4's numbers. `printed` is half of the last digit in print."""
    rows = []
    for name, overshoot, reach, static, stop in (
        ("pid", (9.7, 0.05, ""), (30.0, 0.5, "'after about 30 m'"), (0.0, 0.005, "'none'"), (30.0, 0.5, "")),
        (
            "speedt",
            (0.2, 0.05, "of 15 m/s; of its own steady speed it would be 1.9 %"),
            (12.0, 0.5, "read from a plot: 'after about'"),
            (0.272, 0.0005, "with 101 points in the centroid; 0.269 with 201"),
            (4.5, 0.05, ""),
        ),
        (
            "fuzzy_d",
            (0.0, 0.2, "'about 0 %'; negative: stays below 15 m/s"),
            (4.5, 0.05, "read from a plot: 'after about'"),
            (0.028, 0.0005, ""),
            (1.0, 0.5, "22 % off, but the paper prints whole metres"),
        ),
    ):
        head = heads[name]
        for quantity, unit, (paper, printed, note), ours in (
            ("overshoot", "%", overshoot, head.overshoot_percent),
            ("98 % of steady speed after", "m", reach, head.reach_m),
            ("static error", "m/s", static, head.static_error_mps),
            ("stop error", "m", stop, head.stop_error_m),
        ):
            tolerance = Tolerance(relative=TEN_PERCENT, absolute=printed)
            rows.append(Row(quantity, unit, paper, ours, tolerance, note, TITLES[name]))
    return rows


def _fragility(slow: Headline, ideal: Headline) -> list[Row]:
    group = "How fragile"
    return [
        Row(
            "Fuzzy-D in steps of 10 ms: overshoot",
            "%",
            0.0,
            slow.overshoot_percent,
            None,
            "a 100 Hz loop: the paper's gain does not survive it",
            group,
        ),
        Row("PID with ideal derivative: overshoot", "%", 9.7, ideal.overshoot_percent, None, "", group),
        Row("PID with ideal derivative: 98 % after", "m", 30.0, ideal.reach_m, None, "", group),
    ]


def _physics(heads: dict[str, Headline]) -> list[Row]:
    """What the paper's distances would need, beside what a train has."""
    data = train_data()
    time_s, distance_m = launch(data)
    four_s, four_m = launch(train_data(power_w=4 * 190e3))
    rows = []
    for name, distance in (("pid", 30.0), ("speedt", 12.0), ("fuzzy_d", 4.5)):
        head = heads[name]
        rows += [
            Row(
                f"{TITLES[name]}: mean acceleration to 15 m/s",
                "m/s^2",
                LIMIT_MPS**2 / (2.0 * distance),
                data.max_acceleration_mps2,
                None,
                f"paper: v^2/2x of its {distance:g} m; ours: what the train has",
                PHYSICS,
            ),
            Row(
                f"{TITLES[name]}: peak acceleration in the paper's plant",
                "m/s^2",
                None,
                head.peak_acceleration_mps2,
                None,
                f"jerk {head.peak_jerk_mps3:.0f} m/s^3, peak control {head.peak_control:.0f}",
                PHYSICS,
            ),
        ]
    brake = {b: braking_distance_m(LIMIT_MPS, b, 0.75) for b in (1.0, 1.3)}
    davis = davis_n(LIMIT_MPS, data.davis_mps2.a_n, data.davis_mps2.b_n_per_mps, data.davis_mps2.c_n_per_mps2)
    rows += [
        Row("0 to 15 m/s with 8 x 190 kW", "m", 4.5, distance_m, None, f"in {time_s:.1f} s", PHYSICS),
        Row("0 to 15 m/s with 4 x 190 kW", "m", 4.5, four_m, None, f"in {four_s:.1f} s", PHYSICS),
        Row("15 m/s to a stop with 1.0 m/s^2", "m", 6.49, brake[1.0], None, "jerk 0.75 m/s^3", PHYSICS),
        Row(
            "15 m/s to a stop with 1.3 m/s^2",
            "m",
            6.49,
            brake[1.3],
            None,
            "'100 m before' needs this",
            PHYSICS,
        ),
        Row(
            "drag at 15 m/s",
            "m/s^2",
            DRAG_N_PER_MPS * LIMIT_MPS / MASS_KG,
            davis,
            None,
            "paper: equation 4; ours: Davis in kN on 160 t",
            PHYSICS,
        ),
    ]
    return rows


PHYSICS = "Physically possible?"


def _train_runs(progress: Progress) -> dict[str, TrainRun]:
    laws = train_laws()
    jobs: tuple[tuple[str, Law, bool, float], ...] = (
        ("pid, no anti-windup", laws["pid"], False, 0.0),
        *((name, law, True, 0.0) for name, law in laws.items()),
        *((f"{name}, 100 m early", law, True, 100.0) for name, law in laws.items()),
    )
    runs = {}
    for done, (name, law, anti_windup, early_m) in enumerate(jobs):
        progress("on a train", done / len(jobs))
        runs[name] = drive_train(law, anti_windup=anti_windup, early_m=early_m)
    return runs


def _train(runs: dict[str, TrainRun]) -> list[Row]:
    group = "On a train (160 t, 8 x 190 kW, lag 0.4 s)"
    bare = runs["pid, no anti-windup"]
    rows = [
        Row("PID without anti-windup: overshoot", "%", 9.7, bare.overshoot_percent, None, "as printed", group)
    ]
    for name, (overshoot, reach, stop) in {
        "pid": (9.7, 30.0, 30.0),
        "speedt": (0.2, 12.0, 4.5),
        "fuzzy_d": (0.0, 4.5, 1.0),
    }.items():
        there, early, title = runs[name], runs[f"{name}, 100 m early"], TITLES[name]
        note = "with anti-windup" if name == "pid" else ""
        rows += [
            Row(f"{title}: overshoot", "%", overshoot, there.overshoot_percent, None, note, group),
            Row(f"{title}: 14.7 m/s after", "m", reach, _finite(there.reach_m(14.7)), None, "", group),
            Row(
                f"{title}: stop error", "m", stop, there.stop_error_m, None, "reference drops at 2 km", group
            ),
            Row(
                f"{title}: stop error, 100 m early",
                "m",
                stop,
                early.stop_error_m,
                None,
                "reference drops 100 m before",
                group,
            ),
            Row(
                f"{title}: command changes sign",
                "times",
                None,
                float(there.sign_changes),
                None,
                "bang-bang on a train" if there.sign_changes > 100 else "",
                group,
            ),
        ]
    return rows


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
