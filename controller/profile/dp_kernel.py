"""One backward and one forward pass of the dynamic programming over position and speed, compiled.

State: y = v^2/2 on a grid of its own at every node, even in v between a lower and an upper edge. Control:
the acceleration of a stage, that is the y at its end, off the grid; the value there is interpolated linearly
in y, in which energy is linear.

The small functions are inlined: a call would count references to every array of `Stages` and `DriveArrays`,
which took two thirds of the time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.profile.drive_map import DriveArrays, efficiency_at
from controller.profile.profile import Floats
from controller.profile.stages import NO_LIMIT, Stages, speed_effort

BLOCKED = 1e12
"""Cost [J/kg] of a state from which no control keeps inside: above any energy, and still a number to
interpolate with."""
SLACK = 1e-7
"""Relative tolerance of effort limits, against rounding on the fastest profile."""
ROUNDING = 1e-9
"""Of y [m^2/s^2]; the highest profile itself must not be shut out by its last digit."""
EXTRA = 3
"""Controls beside these: coasting, steady speed, all of the regenerative brake."""


class Controls(NamedTuple):
    """Every control of every state of a corridor, worked out once for all multipliers.

    Shapes (N, grid, controls): `energy` [J/kg] (BLOCKED where not allowed), `time` [s], and where the
    control leads to, as `cell` of the next node's grid and `part` of that cell.
    """

    energy: Floats
    time: Floats
    cell: NDArray[np.int32]
    part: Floats


@njit(cache=True, error_model="numpy")
def controls_of(stages: Stages, drive: DriveArrays, low: Floats, high: Floats, points: int,
                evenly: int) -> Controls:  # fmt: skip
    """The controls of a corridor, `points` states at every node, `evenly` controls from lowest to highest."""
    n = stages.dx.shape[0]
    tries = np.empty(most_controls(drive, evenly))
    most = tries.shape[0]
    energy = np.empty((n, points, most))
    duration = np.empty((n, points, most))
    cell = np.empty((n, points, most), dtype=np.int32)
    part = np.empty((n, points, most))
    for k in range(n):
        dx, floor, ceiling = stages.dx[k], low[k + 1], high[k + 1]
        slowest = np.sqrt(2.0 * floor)
        spacing = (np.sqrt(2.0 * ceiling) - slowest) / (points - 1)
        start = np.sqrt(2.0 * low[k])
        step = (np.sqrt(2.0 * high[k]) - start) / (points - 1)
        for j in range(points if k > 0 else 1):
            v0 = start + j * step
            y0 = min(max(0.5 * v0 * v0, low[k]), high[k])
            count = allowed(stages, drive, k, y0, v0, floor, ceiling, evenly, tries)
            for i in range(most):
                y1 = tries[i]
                v1 = np.sqrt(2.0 * y1)
                if i >= count or v0 + v1 <= 0.0:
                    energy[k, j, i], duration[k, j, i], cell[k, j, i], part[k, j, i] = BLOCKED, 0.0, 0, 0.0
                    continue
                c, share = place_of(y1, v1, slowest, spacing, points)
                energy[k, j, i] = stage_energy(stages, drive, k, y0, y1, v0, v1)
                duration[k, j, i] = 2.0 * dx / (v0 + v1)
                cell[k, j, i] = c
                part[k, j, i] = share
    return Controls(energy, duration, cell, part)


@njit(cache=True)
def most_controls(drive: DriveArrays, evenly: int) -> int:
    """How many controls a state has at most."""
    knots = 2 * drive.efforts.shape[0] if drive.mapped else 0
    return evenly + EXTRA + drive.notches.shape[0] + knots  # type: ignore[no-any-return]


@njit(cache=True, error_model="numpy", inline="always")
def place_of(y: float, v: float, slowest: float, spacing: float, points: int) -> tuple[int, float]:
    """Cell of a node's grid that y = v^2/2 lies in, and how far into it, by y."""
    if spacing <= 0.0:
        return 0, 0.0
    cell = min(max(int((v - slowest) / spacing), 0), points - 2)
    left = slowest + cell * spacing
    right = left + spacing
    share = (2.0 * y - left * left) / (right * right - left * left)
    return cell, min(max(share, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def backward(controls: Controls, multiplier: float, value: Floats) -> None:
    """Fill `value` (N+1, grid): least energy plus `multiplier` times the time to the end [J/kg]."""
    energy, duration, cell, part = controls
    n, points, most = energy.shape
    value[n, :] = 0.0
    for k in range(n - 1, -1, -1):
        for j in range(points if k > 0 else 1):
            best = BLOCKED
            for i in range(most):
                c = cell[k, j, i]
                ahead = value[k + 1, c]
                ahead += part[k, j, i] * (value[k + 1, c + 1] - ahead)
                cost = energy[k, j, i] + multiplier * duration[k, j, i] + ahead
                best = min(best, cost)
            value[k, j] = best
    value[0, :] = value[0, 0]  # one start, not a grid of them


@njit(cache=True, error_model="numpy")
def forward(stages: Stages, drive: DriveArrays, low: Floats, high: Floats, first: float, second: float,
            value_first: Floats, value_second: Floats, switch: int, forced: int, fine: int,
            y: Floats) -> bool:  # fmt: skip
    """Fill `y` (N+1) with the best of `fine` controls a stage; False if it ran into a dead end.

    Before node `switch` the first multiplier and its values decide, from there on the second. In the stage
    after that node control number `forced` is taken whatever it costs, if not negative.
    """
    n = stages.dx.shape[0]
    points = value_first.shape[1]
    tries = np.empty(most_controls(drive, fine))
    y[0] = stages.start
    for k in range(n):
        value, multiplier = (value_first, first) if k < switch else (value_second, second)
        dx, y0, floor, ceiling = stages.dx[k], y[k], low[k + 1], high[k + 1]
        v0 = np.sqrt(2.0 * y0)
        slowest = np.sqrt(2.0 * floor)
        spacing = (np.sqrt(2.0 * ceiling) - slowest) / (points - 1)
        count = allowed(stages, drive, k, y0, v0, floor, ceiling, fine, tries)
        best = 0.5 * BLOCKED
        for i in range(count):
            if k == switch and forced >= 0 and i != forced:
                continue
            y1 = tries[i]
            v1 = np.sqrt(2.0 * y1)
            if v0 + v1 <= 0.0:
                continue
            c, share = place_of(y1, v1, slowest, spacing, points)
            ahead = value[k + 1, c] + share * (value[k + 1, c + 1] - value[k + 1, c])
            energy = stage_energy(stages, drive, k, y0, y1, v0, v1)
            cost = energy + multiplier * 2.0 * dx / (v0 + v1) + ahead
            if cost < best:
                best = cost
                y[k + 1] = y1
        if best >= 0.5 * BLOCKED:
            return False
    return True


@njit(cache=True, error_model="numpy")
def profile_energy(stages: Stages, drive: DriveArrays, y: Floats) -> float:
    """Energy at the line of a whole profile per mass [J/kg]."""
    total = 0.0
    for k in range(stages.dx.shape[0]):
        y0, y1 = y[k], y[k + 1]
        total += stage_energy(stages, drive, k, y0, y1, np.sqrt(2.0 * y0), np.sqrt(2.0 * y1))
    return total


@njit(cache=True, error_model="numpy", inline="always")
def allowed(stages: Stages, drive: DriveArrays, k: int, y0: float, v0: float, floor: float, ceiling: float,
            evenly: int, tries: Floats) -> int:  # fmt: skip
    """Fill `tries` with the y that stage k may end with, inside [floor, ceiling]; returns how many."""
    reach = highest_next(stages, k, y0, v0)
    bottom = max(floor, lowest_next(stages, k, y0, v0))
    top = min(ceiling, reach)
    coast = next_under(stages, k, y0, v0, 0.0)
    if drive.neutral[k] and not stages.friction:
        bottom = max(bottom, coast)  # the regenerative brake, the only one, is dead here
    count = 0
    if drive.mapped and not drive.neutral[k]:
        # The efficiency's corners, where a cost that is not convex has its best efforts.
        for effort in drive.efforts:
            for force in (effort, -effort):
                y1 = next_under(stages, k, y0, v0, force)
                if bottom <= y1 <= top and (force <= 0.0 or drive.notches.shape[0] == 0):
                    tries[count] = y1
                    count += 1
    if drive.notches.shape[0] > 0 or drive.neutral[k]:
        # Traction in steps, or none: the notches, coasting, and braking from coasting downwards.
        if not drive.neutral[k]:
            for notch in drive.notches:
                y1 = next_under(stages, k, y0, v0, notch)
                if bottom <= y1 <= top:
                    tries[count] = y1
                    count += 1
        top = min(top, coast)
    if top < bottom:
        return count
    for i in range(evenly):
        tries[count] = bottom + (top - bottom) * i / (evenly - 1)
        count += 1
    if bottom < coast < top:
        tries[count] = coast
        count += 1
    if bottom < y0 < top:
        tries[count] = y0
        count += 1
    if stages.regeneration_gain > 0.0 and stages.friction:
        # As hard as the regenerative brake can alone: beyond it every metre is lost.
        alone = stages.regeneration.force
        if stages.regeneration.kind != NO_LIMIT:
            alone = min(alone, speed_effort(stages.regeneration, v0)[0])
        if alone < np.inf:
            y1 = next_under(stages, k, y0, v0, -alone)
            if bottom < y1 < top:
                tries[count] = y1
                count += 1
    return count


@njit(cache=True, error_model="numpy", inline="always")
def stage_energy(
    stages: Stages, drive: DriveArrays, k: int, y0: float, y1: float, v0: float, v1: float
) -> float:
    """Energy at the line of stage k per mass [J/kg]."""
    dx, mean = stages.dx[k], 0.5 * (v0 + v1)
    f = (y1 - y0) / dx + stages.c0[k] + stages.c1 * mean + stages.c2 * (y0 + y1)
    if f >= 0.0:
        if drive.mapped:
            return dx * f / efficiency_at(drive.speeds, drive.efforts, drive.traction, mean, f)  # type: ignore[no-any-return]
        return dx * f * stages.traction_cost  # type: ignore[no-any-return]
    if drive.neutral[k] or (stages.regeneration_gain == 0.0 and not drive.mapped):
        return 0.0
    most = min(-f, stages.regeneration.force)
    if stages.regeneration.kind != NO_LIMIT:
        most = min(most, speed_effort(stages.regeneration, v0)[0], speed_effort(stages.regeneration, v1)[0])
    if drive.mapped:
        return -dx * most * efficiency_at(drive.speeds, drive.efforts, drive.regeneration, mean, most)  # type: ignore[no-any-return]
    return -dx * most * stages.regeneration_gain  # type: ignore[no-any-return]


@njit(cache=True, error_model="numpy", inline="always")
def next_under(stages: Stages, k: int, y0: float, v0: float, force: float) -> float:
    """Y at the end of stage k under a constant force per mass; 0 if the train does not get there."""
    dx = stages.dx[k]
    y1 = max(y0 + dx * (force - stages.c0[k] - stages.c1 * v0 - 2.0 * stages.c2 * y0), 0.0)
    for _ in range(3):
        mean = 0.5 * (v0 + np.sqrt(2.0 * y1))
        y1 = max(y0 + dx * (force - stages.c0[k] - stages.c1 * mean - stages.c2 * (y0 + y1)), 0.0)
    return float(y1)


@njit(cache=True, error_model="numpy", inline="always")
def highest_next(stages: Stages, k: int, y0: float, v0: float) -> float:
    """Highest y at the end of stage k that acceleration, traction force and power allow."""
    top = y0 + stages.accelerate * stages.dx[k]
    force = stages.traction.force
    if stages.traction.kind != NO_LIMIT:
        force = min(force, speed_effort(stages.traction, v0)[0])
    if force < np.inf:
        top = min(top, next_under(stages, k, y0, v0, force * (1.0 + SLACK)))
        v1 = np.sqrt(2.0 * top)
        f = (top - y0) / stages.dx[k] + stages.c0[k] + stages.c1 * 0.5 * (v0 + v1) + stages.c2 * (y0 + top)
        reached = (
            stages.traction.kind == NO_LIMIT or f <= (1.0 + SLACK) * speed_effort(stages.traction, v1)[0]
        )
        if not reached and top > y0:
            # The faster end has less effort: approach from below, so that what is found keeps the limit.
            there = speed_effort(stages.traction, np.sqrt(2.0 * top))[0]
            if there < force:
                low, high = y0, top
                for _ in range(30):
                    if high - low <= 1e-10 * high:
                        break
                    middle = 0.5 * (low + high)
                    v1 = np.sqrt(2.0 * middle)
                    f = (middle - y0) / stages.dx[k] + stages.c0[k] + stages.c1 * 0.5 * (v0 + v1)
                    f += stages.c2 * (y0 + middle)
                    if f <= (1.0 + SLACK) * speed_effort(stages.traction, v1)[0]:
                        low = middle
                    else:
                        high = middle
                top = low
    return float(top + ROUNDING)


@njit(cache=True, error_model="numpy", inline="always")
def lowest_next(stages: Stages, k: int, y0: float, v0: float) -> float:
    """Lowest y at the end of stage k that deceleration and brakes allow."""
    bottom = y0 - stages.decelerate * stages.dx[k]
    brake = stages.brake
    if not stages.friction:
        brake = min(brake, stages.regeneration.force)
        if stages.regeneration.kind != NO_LIMIT:
            brake = min(brake, speed_effort(stages.regeneration, v0)[0])
    if brake < np.inf:
        bottom = max(bottom, next_under(stages, k, y0, v0, -brake * (1.0 + SLACK)))
    return float(max(bottom - ROUNDING, 0.0))
