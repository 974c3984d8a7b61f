"""The peer: the same speed-profile problem as a direct nonlinear program for CasADi and IPOPT.

Written from the problem's definition, not from our solver: unknown are the speeds at the nodes and three
forces per stage (traction, regenerative brake, friction brake); nothing is eliminated or convexified.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import casadi
import numpy as np

from controller.profile.problem import Problem


class Peer(NamedTuple):
    """What IPOPT found: energy at the line [J], trip time, speeds; the time it took; whether it succeeded."""

    net_j: float
    trip_time_s: float
    speed_mps: np.ndarray
    solve_time_s: float
    build_time_s: float
    solved: bool
    iterations: int


def solve_ipopt(problem: Problem, *, tolerance: float = 1e-8, guess_mps: np.ndarray | None = None) -> Peer:
    """Optimum of the problem by IPOPT (MUMPS), cold unless a guess is given."""
    began = time.perf_counter()
    opti = casadi.Opti()
    n = len(problem.position_m) - 1
    dx = np.diff(problem.position_m)
    mass, davis = problem.effective_mass_kg, problem.davis
    v = opti.variable(n + 1)
    drive, recover, rub = opti.variable(n), opti.variable(n), opti.variable(n)  # N/kg
    v0, v1 = v[:-1], v[1:]
    mean = (v0 + v1) / 2
    acceleration = (v1 - v0) * mean / dx
    weight = problem.mass_kg * 9.81e-3 * np.asarray(problem.track_n_per_kn)
    resistance = davis.a_n + weight + davis.b_n_per_mps * mean + davis.c_n_per_mps2 * (v0**2 + v1**2) / 2
    opti.subject_to(acceleration + resistance / mass == drive - recover - rub)
    opti.subject_to(opti.bounded(-problem.max_deceleration_mps2, acceleration, problem.max_acceleration_mps2))
    opti.subject_to(opti.bounded(0, v, np.asarray(problem.node_limit_mps)))
    opti.subject_to(v[1:-1] >= 1e-4)
    opti.subject_to(v[0] == problem.start_speed_mps)
    opti.subject_to(v[n] == problem.end_speed_mps)
    opti.subject_to(drive >= 0)
    opti.subject_to(recover >= 0)
    if problem.pneumatic:
        opti.subject_to(rub >= 0)
    else:
        opti.subject_to(rub == 0)
    if problem.max_braking_n is not None:
        opti.subject_to(recover + rub - drive <= problem.max_braking_n / mass)
    for force, efforts in ((drive, problem.traction), (recover, problem.braking)):
        if efforts.max_force_n is not None:
            opti.subject_to(force <= efforts.max_force_n / mass)
        for speed in (v0, v1):
            if efforts.max_power_w is not None:
                opti.subject_to(force * speed <= efforts.max_power_w / mass)
            if efforts.points:
                knots, values = zip(*efforts.points, strict=True)
                knots = (-1.0, *knots, 200.0)
                values = (values[0], *values, values[-1])
                table = casadi.interpolant("table", "linear", [knots], np.asarray(values) / mass)
                opti.subject_to(force <= table(speed.T).T)
    trip = casadi.sum1(dx / mean)
    opti.subject_to(trip == problem.time_s)
    if problem.regeneration_efficiency == 0.0:
        opti.subject_to(recover == 0)
    net = casadi.sum1(dx * (drive / problem.traction_efficiency - problem.regeneration_efficiency * recover))
    opti.minimize(net)
    if guess_mps is None:
        length = problem.length_m
        rise = np.sqrt(2 * 0.5 * np.minimum(problem.position_m, length - problem.position_m) + 0.25)
        guess_mps = np.minimum(np.minimum(rise, 0.95 * problem.node_limit_mps), 1.3 * length / problem.time_s)
    opti.set_initial(v, guess_mps)
    opti.set_initial(drive, 0.2)
    options = {
        "ipopt.print_level": 0,
        "print_time": 0,
        "ipopt.sb": "yes",
        "ipopt.tol": tolerance,
        "ipopt.max_iter": 500,
    }
    opti.solver("ipopt", options)
    built = time.perf_counter()
    try:
        answer = opti.solve()
        solved = True
    except RuntimeError:
        answer = opti.debug
        solved = False
    spent = time.perf_counter() - built
    return Peer(
        float(answer.value(net)) * mass,
        float(answer.value(trip)),
        np.asarray(answer.value(v)),
        spent,
        built - began,
        solved,
        int(opti.stats()["iter_count"]),
    )
