"""Pieces of an interior-point iteration, compiled: efforts, tridiagonal factors, the step and its length."""

from __future__ import annotations

from numba import njit

from controller.profile.profile import Floats
from controller.profile.stages import NO_LIMIT, Stages, speed_effort


@njit(cache=True, error_model="numpy")
def direction(
    n: int, m: int, costs: int, aim_t: float, lam: float, st: float, rt: float, across: float,
    border: Floats, x1: Floats, x2: Floats, y: Floats, floor: Floats, top: Floats, dy: Floats, dc: Floats,
    rd_c: Floats,
    s: Floats, z: Floats, r: Floats, g0: Floats, g1: Floats, ds: Floats, dz: Floats, target: Floats,
    zu: Floats, zl: Floats, dzu: Floats, dzl: Floats, corrector: bool,
) -> tuple[float, float, float, float]:  # fmt: skip
    """All steps from the solution of the condensed system; how far they may go, primal and dual; dlam, dst.

    `target` and `aim_t` are what s z shall change by; the predictor aims at s z = 0 and needs no targets.
    """
    along = 0.0
    for k in range(1, n):
        along += border[k] * x1[k]
    dlam = (aim_t - lam * rt + lam * along) / (st + lam * across)
    change = 0.0
    for k in range(1, n):
        dy[k] = x1[k] - dlam * x2[k]
        change += border[k] * dy[k]
    dst = rt - change
    worst_p = max(0.0, -dst / st)
    worst_d = max(0.0, -dlam / lam)
    for k in range(n):
        dy0, dy1 = dy[k], dy[k + 1]
        d_sum = 0.0
        total = -rd_c[k]
        for i in range(costs):
            t = target[k, i] if corrector else -s[k, i] * z[k, i]
            d = z[k, i] / s[k, i]
            d_sum += d
            total += t / s[k, i] - d * (r[k, i] + g0[k, i] * dy0 + g1[k, i] * dy1)
        step = total / d_sum
        dc[k] = step
        for i in range(m):
            t = target[k, i] if corrector else -s[k, i] * z[k, i]
            inverse = 1.0 / s[k, i]
            moved = r[k, i] + g0[k, i] * dy0 + g1[k, i] * dy1
            if i < costs:
                moved += step
            turned = (t - z[k, i] * moved) * inverse
            ds[k, i] = moved
            dz[k, i] = turned
            worst_p = max(worst_p, -moved * inverse)
            worst_d = max(worst_d, -turned / z[k, i])
    for k in range(1, n):
        up = top[k] - y[k]
        low = y[k] - floor[k]
        tu = dzu[k] if corrector else -zu[k] * up
        tl = dzl[k] if corrector else -zl[k] * low
        dzu[k] = (tu + zu[k] * dy[k]) / up
        dzl[k] = (tl - zl[k] * dy[k]) / low
        worst_p = max(worst_p, dy[k] / up, -dy[k] / low)
        worst_d = max(worst_d, -dzu[k] / zu[k], -dzl[k] / zl[k])
    alpha_p = 1.0 / worst_p if worst_p > 1e-12 else 1e12
    alpha_d = 1.0 / worst_d if worst_d > 1e-12 else 1e12
    if not corrector:
        alpha_p = min(1.0, alpha_p)
        alpha_d = min(1.0, alpha_d)
    return alpha_p, alpha_d, dlam, dst


@njit(cache=True, error_model="numpy")
def stage_efforts(stages: Stages, v0: float, v1: float, value: Floats, slope: Floats) -> None:
    """Efforts at both ends of a stage and their slopes over y, in places 1 to 4."""
    if stages.traction.kind != NO_LIMIT:
        value[1], slope[1] = speed_effort(stages.traction, v0)
        value[2], slope[2] = speed_effort(stages.traction, v1)
    if stages.regeneration.kind != NO_LIMIT:
        value[3], slope[3] = speed_effort(stages.regeneration, v0)
        value[4], slope[4] = speed_effort(stages.regeneration, v1)
    first = max(v0, 1e-3)
    second = max(v1, 1e-3)
    slope[1] /= first
    slope[3] /= first
    slope[2] /= second
    slope[4] /= second


@njit(cache=True, error_model="numpy")
def factor(diagonal: Floats, beside: Floats, n: int) -> None:
    """LDL^T of the inner nodes in place: `diagonal` becomes D, `beside` becomes L; tiny pivots are raised."""
    for k in range(1, n):
        diagonal[k] = max(diagonal[k], 1e-14)
        if k < n - 1:
            factor = beside[k] / diagonal[k]
            diagonal[k + 1] -= factor * beside[k]
            beside[k] = factor


@njit(cache=True, error_model="numpy")
def solve_factored(diagonal: Floats, beside: Floats, x: Floats, n: int) -> None:
    """Solution of L D L^T x = x in place, inner nodes only."""
    for k in range(2, n):
        x[k] -= beside[k - 1] * x[k - 1]
    x[n - 1] /= diagonal[n - 1]
    for k in range(n - 2, 0, -1):
        x[k] = x[k] / diagonal[k] - beside[k] * x[k + 1]
