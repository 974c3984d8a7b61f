"""What `hil profile` is asked for, as a journey and a problem: names, stop numbers and files become data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, cast, get_args

import numpy as np

from controller.profile.mesh import DEFAULT_STEP_M
from controller.profile.no_coasting import accelerate_cruise_brake
from controller.profile.problem import Problem
from controller.profile.profile import Floats, ProfileError
from controller.profile.solution import Solution
from controller.profile.solve import fastest, solve
from hil.bench.errors import ScenarioError
from hil.railway import Journey, Line, RailwayDataError, Stop, load_line, load_train, scenario_table
from hil.railway.library import find_line, find_scenario, find_train

SolverName = Literal["auto", "ip", "dp"]
CURVE_SHARES = (1.02, 1.05, 1.1, 1.15, 1.2, 1.3, 1.4, 1.6)
"""Trip times of the energy-time curve, over the least time."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the command line may change; None: as the train's file says."""

    max_acceleration_mps2: float | None = None
    max_deceleration_mps2: float | None = None
    traction_efficiency: float | None = None
    regeneration_efficiency: float | None = None
    train_length_m: float = 0.0
    max_step_m: float = DEFAULT_STEP_M

    def __post_init__(self) -> None:
        for flag, value in (
            ("--max-acceleration", self.max_acceleration_mps2),
            ("--max-deceleration", self.max_deceleration_mps2),
            ("--max-step", self.max_step_m),
        ):
            if value is not None and not 0.0 < value < math.inf:
                raise ScenarioError(f"{flag} {value:g}: must be greater than 0 and finite")
        if not 0.0 <= self.train_length_m < math.inf:
            raise ScenarioError(f"--train-length {self.train_length_m:g}: must be at least 0 and finite")
        if self.traction_efficiency is not None and not 0.0 < self.traction_efficiency <= 1.0:
            raise ScenarioError(
                f"--traction-efficiency {self.traction_efficiency:g}: must be greater than 0 and at most 1"
            )
        if self.regeneration_efficiency is not None and not 0.0 <= self.regeneration_efficiency <= 1.0:
            raise ScenarioError(
                f"--regeneration-efficiency {self.regeneration_efficiency:g}: must be from 0 to 1"
            )


@dataclass(frozen=True)
class Answer:
    """A solved journey: the profile asked for, others beside it, and the energy-time curve.

    `others` by what they are; `curve` begins with the fastest profile.
    """

    journey: Journey
    best: Solution
    fastest: Solution
    others: dict[str, Solution]
    curve: tuple[Solution, ...]

    @property
    def direction(self) -> int:
        """+1 along the line, -1 against it."""
        return 1 if self.journey.distance_m > 0.0 else -1

    def line_position_m(self, distance_m: Floats) -> Floats:
        """Positions on the line of distances travelled."""
        return self.journey.origin.position_m + self.direction * distance_m


def solver_of(name: str) -> SolverName:
    """The solver of this name."""
    for known in get_args(SolverName):
        if name == known:
            return cast(SolverName, known)
    raise ScenarioError(f"--solver {name}: must be one of {', '.join(get_args(SolverName))}")


def load(line: str, origin: str, destination: str, time_s: float | None, train: str | None) -> Journey:
    """The journey; `line` and `train` as `find_line` and `find_train` take them, stops by name or number."""
    if time_s is None:
        raise ScenarioError("--time is missing: the trip time in seconds, for example --time 78")
    if not 0.0 < time_s < math.inf:
        raise ScenarioError(f"--time {time_s:g}: must be greater than 0 and finite")
    path = find_line(line)
    if train is None:
        train = train_of_scenario(path.stem)
    vehicle = load_train(find_train(train))
    track = load_line(path).capped(vehicle.max_speed_mps)
    start, end = stop(track, origin), stop(track, destination)
    if start.position_m == end.position_m:
        raise ScenarioError(f"FROM and TO are both {start.name!r} at {start.position_m:g} m: no journey")
    return Journey(track, vehicle, start, end, time_s)


def train_of_scenario(line: str) -> str:
    """The train that runs on a shipped line: of the scenario of the same name."""
    try:
        table = scenario_table(find_scenario(line), "journey")
    except RailwayDataError:
        raise ScenarioError(
            f"--train must be given for line {line}: a shipped train (hil list), a TOML file or a TTOBench "
            "JSON file"
        ) from None
    return str(table["train"])


def stop(line: Line, which: str) -> Stop:
    """A stop by its name, in any case, or by its number on the line, from 1. RailwayDataError lists them."""
    for candidate in line.stops:
        if candidate.name.casefold() == which.casefold():
            return candidate
    if which.isascii() and which.isdigit() and 1 <= int(which) <= len(line.stops):
        return line.stops[int(which) - 1]
    names = ", ".join(repr(s.name) for s in line.stops)
    raise RailwayDataError(
        f"line {line.name}: no stop {which!r}; it has {names}, or their numbers 1 to {len(line.stops)}"
    )


def problem_of(journey: Journey, options: Options) -> Problem:
    """The optimisation problem of a journey."""
    return Problem.of_line(
        journey.line,
        journey.train,
        journey.origin.position_m,
        journey.destination.position_m,
        journey.time_s,
        train_length_m=options.train_length_m,
        max_step_m=options.max_step_m,
        max_acceleration_mps2=options.max_acceleration_mps2,
        max_deceleration_mps2=options.max_deceleration_mps2,
        traction_efficiency=options.traction_efficiency,
        regeneration_efficiency=options.regeneration_efficiency,
    )


def answer(journey: Journey, problem: Problem, solver: SolverName, *, compare: bool) -> Answer:
    """Solve it, and what is shown beside it. Raises Infeasible."""
    solve(problem, solver)  # loads the compiled code, so that the time of the next call is the solver's own
    best = solve(problem, solver)
    quickest = fastest(problem)
    others: dict[str, Solution] = {}
    if compare:
        other: Literal["ip", "dp"] = "dp" if best.solver == "ip" else "ip"
        solve(problem, other)
        others[other] = solve(problem, other)
        others["no coasting"] = accelerate_cruise_brake(problem)
    others["fastest"] = quickest
    return Answer(journey, best, quickest, others, tuple(_curve(problem, solver, best, quickest)))


def peak_power_w(solution: Solution) -> float:
    """Largest traction power at the wheel rim [W]: force of a stage times its faster end."""
    fast = np.maximum(solution.speed_mps[1:], solution.speed_mps[:-1])
    return float(np.max(np.maximum(solution.force_n, 0.0) * fast))


def _curve(problem: Problem, solver: SolverName, best: Solution, quickest: Solution) -> list[Solution]:
    times = [share * quickest.trip_time_s for share in CURVE_SHARES]
    found = [quickest]
    placed = False
    for time_s in times:
        if not placed and best.trip_time_s <= time_s:
            found.append(best)
            placed = True
            if abs(best.trip_time_s - time_s) < 0.05:
                continue
        try:
            found.append(
                solve(problem.with_time(time_s), solver, start=found[-1] if len(found) > 1 else None)
            )
        except ProfileError:
            continue  # the curve is beside the answer: it has one point less
    if not placed:
        found.append(best)
    return found


def default_name(journey: Journey) -> str:
    """Name of the results' directory."""
    words = ("profile", journey.line.name, journey.origin.name, journey.destination.name)
    text = "-".join(words)
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in text)
