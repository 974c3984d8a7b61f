"""One step of every control law, beside the plainest of them: the PID, in the same seconds."""

from __future__ import annotations

from collections.abc import Callable
from math import sin

from benchmarks.rows import Row, in_turns_us
from controller.config import ControllerConfig
from controller.laws import Law, Measurement, Reference
from controller.laws.selection import LAWS

DT_S = 0.01
INPUTS = tuple(
    (
        Reference(0.1 * k, 10.0 + sin(0.05 * k), 0.05 * sin(0.05 * k), 0.1),
        Measurement(0.1 * k, 10.0 + sin(0.05 * k) + 0.1 * sin(0.3 * k), -1.3, 1.0, 0.05, None, 0.1),
    )
    for k in range(500)
)


def measure() -> list[Row]:
    config = ControllerConfig()
    rows = []
    for name, entry in LAWS.items():
        ours, peer = in_turns_us(_steps(entry.make(config)), _steps(LAWS["pid"].make(config)))
        rows.append(Row(f"law {name}, one step", ours, peer, "us", "the PID"))
    return rows


def _steps(law: Law) -> Callable[[], object]:
    """One step at each call, through inputs that differ."""
    state = [0]

    def step() -> float:
        state[0] = (state[0] + 1) % len(INPUTS)
        return law.step(*INPUTS[state[0]], DT_S)

    return step
