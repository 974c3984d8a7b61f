"""Energy-optimal speed profiles: interior point and dynamic programming beside CasADi and IPOPT.

The case is Cat Linh - La Thanh at 78 s; IPOPT solves the same problem in the same run, in turns. Its time
includes CasADi's derivatives, which every new problem needs, but not the writing of the program.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from types import ModuleType

from benchmarks.rows import Row
from controller.profile.problem import Efforts, Problem
from controller.profile.solve import fastest, solve
from hil.railway import load_line, load_train
from hil.railway.library import find_line, find_train

TESTS = Path(__file__).parent.parent / "tests" / "controller" / "profile"
FIRST_CALL = """
import time
begun = time.perf_counter()
from benchmarks.profile import paper_case
from controller.profile.solve import solve
problem = paper_case(5.0)
imported = time.perf_counter()
solve(problem, "ip")
print(1e3 * (time.perf_counter() - imported))
"""


def paper_case(max_step_m: float) -> Problem:
    line = load_line(find_line("cat_linh_la_thanh"))
    train = load_train(find_train("cat_linh_4car"))
    problem = Problem.of_line(
        line,
        train,
        line.stops[0].position_m,
        line.stops[-1].position_m,
        78.0,
        max_step_m=max_step_m,
        max_acceleration_mps2=1.1,
        max_deceleration_mps2=1.4,
    )
    return replace(problem, traction=Efforts(), braking=Efforts())


def measure() -> list[Row]:
    solve_ipopt = _module("ipopt").solve_ipopt
    problem = paper_case(0.936)
    stages = problem.stages
    ours, dp, warm, peer = [], [], [], []
    near = solve(problem.with_time(79.0), "dp")
    solve(problem, "ip"), solve(problem, "dp"), solve(problem, "dp", start=near)
    for _ in range(7):
        ours += [_ms(lambda: solve(problem, "ip")) for _ in range(10)]
        dp.append(_ms(lambda: solve(problem, "dp")))
        warm.append(_ms(lambda: solve(problem, "dp", start=near)))
        answer = solve_ipopt(problem)
        peer.append(answer.solve_time_s * 1e3)
    energies = [solve(problem, solver).net_j / 1e6 for solver in ("ip", "dp")]
    rows = [
        Row(
            f"profile, {stages} stages, interior point",
            median(ours),
            median(peer),
            "ms",
            "CasADi and IPOPT",
        ),
        Row(
            f"profile, {stages} stages, dynamic programming",
            median(dp),
            median(peer),
            "ms",
            "CasADi and IPOPT",
        ),
        Row(
            f"profile, {stages} stages, dynamic programming from the profile for 79 s",
            median(warm),
            median(peer),
            "ms",
            "CasADi and IPOPT",
        ),
        Row("its energy, interior point", energies[0], answer.net_j / 1e6, "MJ", "IPOPT"),
        Row("its energy, dynamic programming", energies[1], answer.net_j / 1e6, "MJ", "IPOPT"),
    ]
    default = paper_case(5.0)
    rows.append(
        Row(
            f"profile, {default.stages} stages (default mesh), interior point",
            median(_ms(lambda: solve(default, "ip")) for _ in range(30)),
            None,
            "ms",
            "the paper's MATLAB took 8171 ms for 1000 stages",
        )
    )
    for km in (9, 18, 36):
        long = _long_line(km * 1000.0)
        taken = median(_ms(lambda problem=long: solve(problem, "ip")) for _ in range(9))  # type: ignore[misc]
        peer_ms = solve_ipopt(long).solve_time_s * 1e3 if km == 36 else None
        rows.append(
            Row(f"profile, {km} km in {long.stages} stages, interior point", taken, peer_ms, "ms",
                "CasADi and IPOPT" if peer_ms else "cost over length")
        )  # fmt: skip
    first = subprocess.run(
        [sys.executable, "-c", FIRST_CALL], capture_output=True, text=True, check=True, cwd=TESTS.parents[2]
    )
    rows.append(
        Row("first solve of a process, code cached", float(first.stdout), None, "ms", "1000 ms allowed")
    )
    return rows


def _long_line(length_m: float) -> Problem:
    """One run without a stop over a random route of this length, 6 % above its least time."""
    problem = _module("routes").random_route(1, max_step_m=10.0, length_m=length_m)
    problem = replace(problem, traction=Efforts(None, 2.2e6), regeneration_efficiency=0.0)
    return problem.with_time(1.06 * fastest(problem).trip_time_s)


def _ms(call: Callable[[], object]) -> float:
    begun = time.perf_counter()
    call()
    return 1e3 * (time.perf_counter() - begun)


def _module(name: str) -> ModuleType:
    """The peer and the routes that the tests use."""
    spec = importlib.util.spec_from_file_location(name, TESTS / f"{name}.py")
    if spec is None or spec.loader is None:
        raise FileNotFoundError(TESTS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
