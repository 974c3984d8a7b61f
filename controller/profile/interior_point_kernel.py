"""The interior point itself, compiled: Mehrotra's predictor and corrector on a tridiagonal system.

Unknown are y = v^2/2 at the inner nodes and the cost c of each stage, an epigraph c >= g over every piece of
the cost. Each condition of a stage touches c and the two y at its ends, so c is eliminated in closed form and
what is left couples neighbours only. The trip time couples all; it is a border of one row.

S. Mehrotra, On the implementation of a primal-dual interior point method, SIAM J. Optim. 2 (1992).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from controller.profile.interior_point_steps import direction, factor, solve_factored, stage_efforts
from controller.profile.profile import Floats
from controller.profile.stages import Stages
from controller.profile.sweep import trip_time_s

CONVERGED, STALLED = 0, 1


class Conditions(NamedTuple):
    """Conditions of a stage: `cost` c + `force` f + `acceleration` a + `gain` E(v) + `constant` >= 0.

    E(v) is the traction effort at the first (1) or second (2) node, or the regenerative one (3, 4);
    `effort` says which, 0 none. The first `costs` conditions have `cost` 1, the others 0.
    """

    costs: int
    force: Floats
    acceleration: Floats
    gain: Floats
    effort: Floats
    constant: Floats


class Start(NamedTuple):
    """How one attempt begins and how boldly it steps."""

    barrier: float
    least_centring: float
    equal_steps: bool
    multiplier: float


@njit(cache=True, error_model="numpy")
def interior_point(
    stages: Stages,
    conditions: Conditions,
    time_s: float,
    y: Floats,
    floor: Floats,
    begin: Start,
    max_iterations: int,
    tolerance: float,
) -> tuple[Floats, float, int, int, float]:
    """Y of least energy within `time_s`, its multiplier [W/kg], state, iterations and the last error.

    Begins at `y`, which lies between `floor` and the limits at the inner nodes.
    """
    y = y.copy()
    n = stages.dx.shape[0]
    m = conditions.force.shape[0]
    costs = conditions.costs
    c1, c2 = stages.c1, stages.c2
    top = stages.top

    c = np.empty(n)
    s = np.empty((n, m))
    z = np.empty((n, m))
    r = np.empty((n, m))
    g0 = np.empty((n, m))
    g1 = np.empty((n, m))
    ds = np.empty((n, m))
    dz = np.empty((n, m))
    target = np.empty((n, m))
    rd_c = np.empty(n)
    dc = np.empty(n)
    zu = np.empty(n + 1)
    zl = np.empty(n + 1)
    dzu = np.empty(n + 1)
    dzl = np.empty(n + 1)
    rd = np.empty(n + 1)
    diagonal = np.empty(n + 1)
    beside = np.empty(n)
    border = np.empty(n + 1)
    x1 = np.empty(n + 1)
    x2 = np.empty(n + 1)
    dy = np.zeros(n + 1)
    v = np.empty(n + 1)
    value = np.empty(5)
    slope = np.empty(5)
    value[0] = slope[0] = 0.0

    # slacks from the conditions, but never at the border; multipliers from the barrier
    for k in range(n + 1):
        v[k] = np.sqrt(2.0 * y[k])
        zu[k] = begin.barrier / max(top[k] - y[k], 1e-2)
        zl[k] = begin.barrier / max(y[k] - floor[k], 1e-2)
    for k in range(n):
        stage_efforts(stages, v[k], v[k + 1], value, slope)
        dx = stages.dx[k]
        a = (y[k + 1] - y[k]) / dx
        f = a + stages.c0[k] + c1 * 0.5 * (v[k] + v[k + 1]) + c2 * (y[k] + y[k + 1])
        highest = -1e300
        for i in range(costs):
            e = int(conditions.effort[i])
            rest = conditions.force[i] * f + conditions.gain[i] * value[e] + conditions.constant[i]
            highest = max(highest, -rest)
        c[k] = highest + 0.1
        for i in range(m):
            e = int(conditions.effort[i])
            rest = conditions.force[i] * f + conditions.acceleration[i] * a
            rest += conditions.gain[i] * value[e] + conditions.constant[i]
            if i < costs:
                rest += c[k]
            s[k, i] = max(rest, 0.02)
            z[k, i] = begin.barrier / s[k, i]
            if i < costs:
                z[k, i] = max(z[k, i], 0.1 * dx)
    lam = begin.multiplier
    st = max(time_s - trip_time_s(stages.dx, y), 1e-3 * time_s)
    count = n * m + 2 * (n - 1) + 1
    error = np.inf
    alpha_p = alpha_d = 1.0

    for iteration in range(max_iterations):
        # ---- residuals, and the condensed system
        gap = lam * st
        worst_p = 0.0
        worst_c = 0.0
        total_time = 0.0
        energy = 0.0
        for k in range(n + 1):
            v[k] = np.sqrt(2.0 * y[k])
            rd[k] = 0.0
            diagonal[k] = 0.0
            border[k] = 0.0
            x1[k] = 0.0
        for k in range(n):
            dx = stages.dx[k]
            v0, v1 = v[k], v[k + 1]
            mean = 0.5 * (v0 + v1)
            h0 = 0.5 / v0 if v0 > 0.0 else 0.0
            h1 = 0.5 / v1 if v1 > 0.0 else 0.0
            stage_efforts(stages, v0, v1, value, slope)
            inverse = 1.0 / dx
            a = (y[k + 1] - y[k]) * inverse
            f = a + stages.c0[k] + c1 * mean + c2 * (y[k] + y[k + 1])
            f0 = -inverse + c1 * h0 + c2
            f1 = inverse + c1 * h1 + c2
            total_time += dx / mean
            t1 = -dx / (mean * mean)
            border[k] += t1 * h0
            border[k + 1] += t1 * h1
            t2 = 2.0 * lam * dx / (mean * mean * mean)
            k00 = t2 * h0 * h0
            k01 = t2 * h0 * h1
            k11 = t2 * h1 * h1
            pull = 0.0
            d_sum = 0.0
            q_sum = 0.0
            z_sum = 0.0
            b0 = b1 = 0.0
            l0 = l1 = 0.0
            w0 = w1 = 0.0
            for i in range(m):
                e = int(conditions.effort[i])
                cf = conditions.force[i]
                ca = conditions.acceleration[i] * inverse
                cg = conditions.gain[i]
                rest = cf * f + conditions.acceleration[i] * a + cg * value[e] + conditions.constant[i]
                u0 = cf * f0 - ca
                u1 = cf * f1 + ca
                if e % 2 == 1:
                    u0 += cg * slope[e]
                elif e != 0:
                    u1 += cg * slope[e]
                g0[k, i] = u0
                g1[k, i] = u1
                zi = z[k, i]
                si = s[k, i]
                if i < costs:
                    rest += c[k]
                ri = rest - si
                r[k, i] = ri
                worst_p = max(worst_p, abs(ri))
                gap += si * zi
                pull -= zi * cf
                l0 -= zi * u0
                l1 -= zi * u1
                d = zi / si
                q = -zi - d * ri
                b0 += q * u0
                b1 += q * u1
                if i < costs:
                    # pairs: sum of D_i D_j (g_i - g_j)^2 / sum of D, without cancellation, one at a time
                    if i > 0:
                        share = d * d_sum / (d_sum + d)
                        p0 = u0 - w0
                        p1 = u1 - w1
                        k00 += share * p0 * p0
                        k01 += share * p0 * p1
                        k11 += share * p1 * p1
                        part = d / (d_sum + d)
                        w0 += part * p0
                        w1 += part * p1
                    else:
                        w0 = u0
                        w1 = u1
                    d_sum += d
                    q_sum += q
                    z_sum += zi
                else:
                    k00 += d * u0 * u0
                    k01 += d * u0 * u1
                    k11 += d * u1 * u1
            rd_c[k] = dx - z_sum
            worst_c = max(worst_c, abs(rd_c[k]) * inverse)
            energy += dx * abs(c[k])
            rest = q_sum - rd_c[k]
            b0 -= rest * w0
            b1 -= rest * w1
            curve = lam * t1 + c1 * pull
            if curve > 0.0:
                curve = 0.5 * lam * t1
            k00 -= 4.0 * curve * h0 * h0 * h0
            k11 -= 4.0 * curve * h1 * h1 * h1
            diagonal[k] += k00
            diagonal[k + 1] += k11
            beside[k] = k01
            rd[k] += l0
            rd[k + 1] += l1
            x1[k] += b0
            x1[k + 1] += b1
        worst_d = 0.0
        for k in range(1, n):
            up = top[k] - y[k]
            low = y[k] - floor[k]
            gap += zu[k] * up + zl[k] * low
            rd[k] += lam * border[k] + zu[k] - zl[k]
            worst_d = max(worst_d, abs(rd[k]))
            diagonal[k] += zu[k] / up + zl[k] / low
            x1[k] += -rd[k] + zu[k] - zl[k]
        rt = time_s - total_time - st
        mu = gap / count
        error = max(worst_p, worst_c, worst_d, 0.1 * abs(rt), gap / (energy + 1.0))
        if not np.isfinite(gap + total_time):
            return y, lam, STALLED, iteration, np.inf
        if error < tolerance:
            return y, lam, CONVERGED, iteration, error

        # ---- factor, border, predictor
        factor(diagonal, beside, n)
        for k in range(n + 1):
            x2[k] = border[k]
        solve_factored(diagonal, beside, x2, n)
        solve_factored(diagonal, beside, x1, n)
        across = 0.0
        for k in range(1, n):
            across += border[k] * x2[k]
        alpha_p, alpha_d, dlam, dst = direction(
            n, m, costs, -lam * st, lam, st, rt, across, border, x1, x2, y, floor, top, dy, dc, rd_c,
            s, z, r, g0, g1, ds, dz, target, zu, zl, dzu, dzl, False,
        )  # fmt: skip
        after = (lam + alpha_d * dlam) * (st + alpha_p * dst)
        for k in range(n):
            for i in range(m):
                after += (s[k, i] + alpha_p * ds[k, i]) * (z[k, i] + alpha_d * dz[k, i])
        for k in range(1, n):
            after += (zu[k] + alpha_d * dzu[k]) * (top[k] - y[k] - alpha_p * dy[k])
            after += (zl[k] + alpha_d * dzl[k]) * (y[k] - floor[k] + alpha_p * dy[k])
        ratio = max(after, 0.0) / gap
        centring = min(max(ratio * ratio * ratio, begin.least_centring), 1.0)

        # ---- corrector
        # a gap far below the tolerance would only lose digits
        aim = max(centring * mu, 0.1 * tolerance * (energy + 1.0) / count)
        for k in range(n + 1):
            x1[k] = -rd[k]
        for k in range(n):
            d_sum = q_sum = 0.0
            w0 = w1 = b0 = b1 = 0.0
            for i in range(m):
                d = z[k, i] / s[k, i]
                t = aim - s[k, i] * z[k, i] - ds[k, i] * dz[k, i]
                target[k, i] = t
                q = t / s[k, i] - d * r[k, i]
                b0 += q * g0[k, i]
                b1 += q * g1[k, i]
                if i < costs:
                    d_sum += d
                    q_sum += q
                    w0 += d * g0[k, i]
                    w1 += d * g1[k, i]
            rest = (q_sum - rd_c[k]) / d_sum
            x1[k] += b0 - rest * w0
            x1[k + 1] += b1 - rest * w1
        for k in range(1, n):
            up = top[k] - y[k]
            low = y[k] - floor[k]
            tu = aim - zu[k] * up + dzu[k] * dy[k]
            tl = aim - zl[k] * low - dzl[k] * dy[k]
            dzu[k] = tu  # kept for the step below
            dzl[k] = tl
            x1[k] -= tu / up - tl / low
        solve_factored(diagonal, beside, x1, n)
        alpha_p, alpha_d, dlam, dst = direction(
            n, m, costs, aim - lam * st - dlam * dst, lam, st, rt, across, border, x1, x2, y, floor, top,
            dy, dc, rd_c, s, z, r, g0, g1, ds, dz, target, zu, zl, dzu, dzl, True,
        )  # fmt: skip
        keep = max(0.9, 1.0 - 10.0 * mu) if mu < 0.1 else 0.9
        keep = min(keep, 0.9995)
        alpha_p = min(1.0, keep * alpha_p)
        alpha_d = min(1.0, keep * alpha_d)
        if begin.equal_steps:
            alpha_p = alpha_d = min(alpha_p, alpha_d)
        lam += alpha_d * dlam
        st += alpha_p * dst
        for k in range(n):
            c[k] += alpha_p * dc[k]
            for i in range(m):
                s[k, i] += alpha_p * ds[k, i]
                z[k, i] += alpha_d * dz[k, i]
        for k in range(1, n):
            y[k] += alpha_p * dy[k]
            zu[k] += alpha_d * dzu[k]
            zl[k] += alpha_d * dzl[k]
    return y, lam, STALLED, max_iterations, error
