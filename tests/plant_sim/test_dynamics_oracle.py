"""Whole runs against an adaptive solver: same orders, equations written down a second time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant_sim.dynamics import Orders
from plant_sim.vehicle import PROMPT_RATE_FACTOR, RATE_LOOP_S, Deviations, Disturbance, Vehicle

# Measured: 0.06 mm and 0.001 mm/s. The bench judges a stop to the millimetre.
POSITION_TOLERANCE_M = 5e-4
SPEED_TOLERANCE_MPS = 1e-4
CYCLE_S = 0.01

TEST_LINE_SCRIPT = (
    (1.0, 0.0), (24.0, 0.85), (15.0, 0.12), (20.0, 0.0), (6.0, -0.6), (10.0, 0.3), (40.0, 0.05), (25.0, 0.0),
    (20.0, -0.65),
)  # fmt: skip
CAT_LINH_SCRIPT = ((1.0, 0.0), (11.0, 0.9), (18.0, 0.45), (16.0, 0.0), (8.0, -0.3), (3.0, 0.2), (25.0, -0.7))


class Oracle:
    """The train as an ordinary differential equation, solved piece by piece between order changes."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self.train = vehicle.train
        self.mass = vehicle.effective_mass_kg
        deviations = vehicle.deviations
        self.drive_lag_s = self.train.electrodynamic.time_constant_s * deviations.time_constant_factor
        self.traction_lag_s = self.train.traction.time_constant_s * deviations.time_constant_factor
        self.friction_lag_s = self.train.pneumatic.time_constant_s * deviations.friction_time_constant_factor
        self.friction_share = deviations.brake_factor * deviations.friction_brake_factor

    def run(self, orders: Sequence[Orders], start_m: float, pneumatic_n: float) -> np.ndarray:
        """States (cycles, 6) at the end of every cycle: x, v, rate-limited drive, drive, brake twice."""
        train = self.train
        ends = np.arange(1, len(orders) + 1) * CYCLE_S
        delays = [train.traction.dead_time_s, train.electrodynamic.dead_time_s, train.pneumatic.dead_time_s]
        state = np.array([start_m, 0.0, 0.0, 0.0, pneumatic_n, pneumatic_n])
        states = np.empty((len(orders), 6))
        pieces: list[tuple[int, tuple[float, float, float, bool]]] = []
        for cycle in range(len(orders)):
            back = [cycle - round(delay / CYCLE_S) for delay in delays]
            piece = (
                max(0.0, orders[back[0]].demand) if back[0] >= 0 else 0.0,
                min(0.0, orders[back[1]].demand) if back[1] >= 0 else 0.0,
                orders[back[2]].pneumatic_n if back[2] >= 0 else pneumatic_n,
                orders[cycle].prompt,
            )
            if not pieces or pieces[-1][1] != piece:
                pieces.append((cycle, piece))
        pieces.append((len(orders), pieces[-1][1]))
        for (first, piece), (last, _) in pairwise(pieces):
            state = self._piece(state, piece, first * CYCLE_S, ends[first:last], states[first:last])
        return states

    def _piece(
        self, state: np.ndarray, piece: Any, start_s: float, ends: np.ndarray, out: np.ndarray
    ) -> np.ndarray:
        done = 0
        while done < len(ends):
            direction = self._direction(start_s, state)

            def event(t: float, y: np.ndarray, direction: float = direction, begin: float = start_s) -> float:
                if direction == 0.0:
                    force, hold = self._standing(t, y)
                    return hold - abs(force)
                return float(direction * y[1]) if abs(y[1]) > 1e-9 or begin < t - 1e-6 else 1.0

            event.terminal = True  # type: ignore[attr-defined]
            event.direction = -1  # type: ignore[attr-defined]
            solution = solve_ivp(
                lambda t, y, s=direction: self._rates(t, y, piece, s),
                (start_s, ends[-1]),
                state,
                method="DOP853",
                t_eval=ends[done:],
                events=event,
                rtol=1e-9,
                atol=1e-7,
                max_step=0.25,
            )
            got = solution.y.shape[1]
            out[done : done + got] = solution.y.T
            done += got
            if len(solution.t_events[0]):
                start_s, state = float(solution.t_events[0][0]), solution.y_events[0][0].copy()
                if direction != 0.0:
                    state[1] = 0.0
                else:
                    state[1] = 1e-12 * np.sign(self._standing(start_s, state)[0])
            else:
                state = solution.y[:, -1]
        return state

    def _direction(self, t: float, y: np.ndarray) -> float:
        if y[1] != 0.0:
            return float(np.sign(y[1]))
        force, hold = self._standing(t, y)
        return 0.0 if abs(force) <= hold else float(np.sign(force))

    def _track(self, t: float, x: float) -> tuple[float, float]:
        length = self.train.length_m
        weight = self.vehicle.mass_kg * 9.81e-3
        gradient = self.vehicle.line.mean_gradient(x, length)
        friction = weight * (self.vehicle.line.mean_specific_resistance(x, length) - gradient)
        gust = self.vehicle.disturbance
        push = gust.amplitude_mps2 * np.sin(gust.angular_frequency_radps * t + gust.phase_rad) * self.mass
        return weight * gradient * self.vehicle.deviations.gradient_factor - push, friction

    def _standing(self, t: float, y: np.ndarray) -> tuple[float, float]:
        gradient, friction = self._track(t, y[0])
        starting = self.train.starting_resistance_n_per_kn * self.vehicle.mass_kg * 9.81e-3
        brake = y[5] * self.friction_share
        return max(y[3], 0.0) - gradient, brake + self.train.davis.a_n + friction + starting

    def _rates(self, t: float, y: np.ndarray, piece: Any, direction: float) -> list[float]:
        traction, braking, friction_order, prompt = piece
        x, v, limited, drive, brake_limited, brake = y
        train = self.train
        unit = train.electrodynamic if braking < 0.0 else train.traction
        target = train.effort_n(traction, v) if traction > 0.0 else 0.0
        if braking < 0.0:
            lag = self.drive_lag_s
            brake_soon = brake + min(1.0, lag / self.friction_lag_s) * (brake_limited - brake)
            rest = -train.effort_n(braking, v) - brake_soon
            speed_soon = max(0.0, abs(v) + braking * train.max_braking_mps2 * lag)
            target -= np.clip(rest, 0.0, train.electrodynamic.effort_n(speed_soon))
        nominal = train.effective_mass_kg
        rate = unit.jerk_limit_mps3 * nominal
        brake_rate = train.electrodynamic.jerk_limit_mps3 * nominal * (PROMPT_RATE_FACTOR if prompt else 1.0)
        gradient, friction = self._track(t, x)
        acceleration = 0.0
        if direction != 0.0:
            brakes = brake * self.friction_share + max(-drive, 0.0) * self.vehicle.deviations.brake_factor
            against = train.davis.resistance_n(v) + friction + brakes
            acceleration = (max(drive, 0.0) - gradient - direction * against) / self.mass
        return [
            v if direction != 0.0 else 0.0,
            acceleration,
            float(np.clip((target - limited) / RATE_LOOP_S, -rate, rate)),
            (limited - drive) / (self.drive_lag_s if braking < 0.0 else self.traction_lag_s),
            float(np.clip((friction_order - brake_limited) / RATE_LOOP_S, -brake_rate, brake_rate)),
            (brake_limited - brake) / self.friction_lag_s,
        ]


WORN = Deviations(
    mass_factor=1.1, brake_factor=1.1, gradient_factor=1.2, friction_brake_factor=0.85,
    time_constant_factor=1.4, friction_time_constant_factor=0.8,
)  # fmt: skip


@pytest.mark.parametrize(
    ("train", "line", "script", "deviations", "disturbance"),
    [
        ("urban", "paper_line", TEST_LINE_SCRIPT, Deviations(), Disturbance()),
        ("cat_linh", "cat_linh_line", CAT_LINH_SCRIPT, Deviations(), Disturbance()),
        ("urban", "paper_line", TEST_LINE_SCRIPT, WORN, Disturbance(0.05, 1.0, 0.3)),
    ],
)
def test_whole_run_agrees_with_an_adaptive_solver(
    train: str,
    line: str,
    script: Any,
    deviations: Deviations,
    disturbance: Disturbance,
    scripted: Callable[..., Any],
    request: pytest.FixtureRequest,
) -> None:
    vehicle = Vehicle(
        request.getfixturevalue(train), request.getfixturevalue(line), deviations, disturbance=disturbance
    )
    holding_n = vehicle.train.pneumatic.holding_effort_n
    run = scripted(vehicle, script, pneumatic_n=holding_n)
    oracle = Oracle(vehicle).run(run.orders, 0.0, holding_n)
    position, speed = run.column("position_m"), run.column("speed_mps")
    assert np.max(speed) > 8.0
    assert position[-1] > 800.0
    assert speed[-1] == 0.0
    assert np.max(np.abs(position - oracle[:, 0])) < POSITION_TOLERANCE_M
    assert np.max(np.abs(speed - oracle[:, 1])) < SPEED_TOLERANCE_MPS
