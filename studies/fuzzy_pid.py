"""The fuzzy-PID paper: what moving a PID's gains by fuzzy rules buys on a 36 km main line.

Zhou Hongbin 2014, article 1009-914X(2014)18-0111-01 (in Chinese). It prints no number of its result
("accurate and smooth tracking"), so nothing can be reproduced or not; the study asks its question: is a fuzzy
PID better than a fixed one? It is measured against fixed gains, with and without feed-forward.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from studies.figure import Figure, Line, Panel, Role
from studies.fuzzy_pid_laws import DERIVATIVE_FILTER_PER_S, Contender, contenders
from studies.fuzzy_pid_plant import CLIMB_M, Plan, Run, drive, plan, sensitivity_peak
from studies.study import Progress, Study, silent
from studies.table import Row

__all__ = ["run", "runs"]

KMH = 3.6


def run(progress: Progress = silent) -> Study:
    """Drive the line with all controllers."""
    reference = plan()
    found = runs(reference, progress)
    return Study(
        name="fuzzy_pid",
        title="Fuzzy PID on a 36 km main line",
        paper="Zhou Hongbin 2014, article 1009-914X(2014)18-0111-01 (in Chinese), sections 2 to 4",
        rows=_rows(found),
        contradictions=CONTRADICTIONS,
        assumptions=(*ASSUMPTIONS, f"The run takes {reference.time_s[-1]:.0f} s."),
        figures=_figures(reference, found),
    )


def runs(reference: Plan, progress: Progress = silent) -> dict[str, tuple[Contender, Run]]:
    """Every controller on the line, by name."""
    found = {}
    everyone = contenders()
    for done, contender in enumerate(everyone):

        def watch(part: float, what: str = contender.title, done: int = done) -> None:
            progress(what, (done + part) / len(everyone))

        watch(0.0)
        found[contender.name] = (
            contender,
            drive(contender.law, reference, feed_forward=contender.feed_forward, watch=watch),
        )
    return found


CONTRADICTIONS = (
    "The constants a, b, c 'at most 0.0015, 0.27, 215' cannot be in the order of w0 = a + bv + cv^2: 215 on "
    "v^2 is absurd. Read as quadratic, linear, constant in N/t with V in km/h they are 0.26 m/s2 at "
    "108 km/h, still high for a train.",
    "The train is a point mass because the climb 'is longer than the train': that does not hold at its "
    "ends, where a train meets the gradient over its length.",
    "The textbook's tables are not mirror-symmetric: with e = r - v they raise kp for e < 0 and lower it for "
    "e > 0, against the paper's own words on |e|. The 'symmetric' tables are made from those words.",
)

ASSUMPTIONS = (
    "Printed are 36.28 km, one climb of 9.68 km at 15 permille and five phases; no result has a number.",
    "Chosen: climb from km 12.00 to 21.68; 30 m/s, 25 m/s from 200 m before to 200 m behind it.",
    "Chosen: 0.6 m/s2 within 80 % of 16 W/kg, 0.3 m/s2 down to the climb's speed, to the stop 0.8 of 1.1 "
    "m/s2, jerk 0.5 m/s3.",
    "Chosen: drive with dead time 0.2 s and lag 0.6 s; sample time 0.1 s; speed in steps of 0.01 km/h.",
    "Chosen: 'moderate' gains as set by hand; 'tuned' from a search over a similar loop. "
    "Fuzzy: moved by at most 50 % (moderate) or 10 % (tuned) over |e| <= 1.5 m/s and |de| <= 0.6 m/s2.",
    "Braking into the climb and its margins are chosen so that the tuned PID has no more than 0.06 m/s.",
    "Ms, the sensitivity's peak, is the largest over the gains that a controller used, each taken as fixed. "
    "It differs from row to row: a lower RMS error with a higher Ms is no better controller.",
)


def _rows(found: Mapping[str, tuple[Contender, Run]]) -> list[Row]:
    rows = []
    headings = {
        "moderate": "Moderate gains",
        "tuned": "Tuned gains",
        "forward": "Tuned gains with feed-forward (acceleration, resistance, gradient)",
    }
    for name, (contender, result) in found.items():
        group = headings[contender.base]
        base = found[contender.base][1]
        kind = contender.title.split(",")[0]
        used = contender.gains if name == contender.base else np.unique(np.round(result.gains, 4), axis=0)
        peak = sensitivity_peak(np.array(used, dtype=np.float64), DERIVATIVE_FILTER_PER_S)
        against = (
            "" if name == contender.base else f"{_percent(result.rms_mps, base.rms_mps)} of the fixed PID's"
        )
        rows += [
            Row(f"{kind}: RMS error", "m/s", None, result.rms_mps, None, against, group),
            Row(f"{kind}: max |e|", "m/s", None, result.max_mps, None, "", group),
            Row(
                f"{kind}: max |e| at the climb's ends", "m/s", None, result.max_at_edges_mps, None, "", group
            ),
            Row(f"{kind}: Ms", "1", None, peak, None, "", group),
        ]
    gain = {name: result.rms_mps for name, (_, result) in found.items()}
    group = "What buys what"
    rows += [
        Row(
            "RMS error with feed-forward over without, fixed PID",
            "1",
            None,
            gain["forward"] / gain["tuned"],
            None,
            "not at equal Ms either",
            group,
        ),
        *(
            Row(
                f"RMS error of the best fuzzy PID over fixed, {title}",
                "1",
                None,
                min(gain[f"{base}_textbook"], gain[f"{base}_symmetric"]) / gain[base],
                None,
                "not at equal Ms: no proof that a schedule is better",
                group,
            )
            for base, title in (("tuned", "no feed-forward"), ("forward", "feed-forward"))
        ),
    ]
    return rows


def _percent(ours: float, base: float) -> str:
    return f"{100.0 * ours / base:.0f} %"


def _figures(reference: Plan, found: Mapping[str, tuple[Contender, Run]]) -> list[Figure]:
    def lines(names: tuple[str, ...], series: str, scale: float = 1.0, *roles: Role) -> list[Line]:
        return [
            Line(
                found[name][0].title,
                role,
                found[name][1].time_s,
                scale * getattr(found[name][1], series),
            )
            for name, role in zip(names, roles, strict=True)
        ]

    wanted = Line("reference", "reference", reference.time_s, KMH * reference.speed_mps)
    result = found["tuned_symmetric"][1]
    edge = float(result.time_s[np.argmax(result.position_m >= CLIMB_M[0])])
    speed = [*lines(("tuned_symmetric", "forward"), "speed_mps", KMH, "b", "c"), wanted]
    tracking = Figure(
        "fig1_tracking",
        "Speed tracking",
        "time_s",
        "time [s]",
        [
            Panel("Whole run", "speed [km/h]", speed),
            Panel("Start", "speed [km/h]", speed, (0.0, 15.0), (0.0, 32.0)),
            Panel("Foot of the climb", "speed [km/h]", speed, (edge - 10.0, edge + 30.0), (88.8, 90.9)),
        ],
        "Fig. 1",
    )
    pairs = (
        ("Moderate gains", ("moderate", "moderate_symmetric")),
        ("Tuned gains", ("tuned", "tuned_symmetric")),
        ("Tuned gains with feed-forward", ("forward", "forward_symmetric")),
    )
    error = Figure(
        "error",
        "Speed error",
        "time_s",
        "time [s]",
        [
            Panel(title, "error [m/s]", lines(names, "error_mps", 1.0, "a", "b"), None, (-1.4, 1.4))
            for title, names in pairs
        ],
    )
    climb = Figure(
        "climb",
        "Speed error at the foot of the climb (15 permille, point mass)",
        "time_s",
        "time [s]",
        [
            Panel(
                title,
                "error [m/s]",
                lines(names, "error_mps", 1.0, "a", "b"),
                (edge - 5.0, edge + 40.0),
                (-0.3, 0.5),
            )
            for title, names in pairs
        ],
    )
    gains = found["moderate_symmetric"][1]
    moved = Figure(
        "gains",
        "Gains that the symmetric fuzzy PID used (moderate gains)",
        "time_s",
        "time [s]",
        [
            Panel(label, unit, [Line(label, "a", gains.time_s, gains.gains[:, k])])
            for k, (label, unit) in enumerate((("kp", "kp [1/s]"), ("ki", "ki [1/s^2]"), ("kd", "kd [1]")))
        ],
    )
    return [tracking, error, climb, moved]
