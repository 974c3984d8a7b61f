"""What is to be measured: parts, slices and their order."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.bench.errors import ScenarioError
from hil.bench.scenario import Scenario
from hil.canbus.transport import BusOptions

__all__ = ["FULL", "FULL_ALONE", "LOOP_PLAIN", "LOOP_SPIN", "PEER", "TITLES", "TimingRequest"]

LOOP_PLAIN = "loop_plain"
LOOP_SPIN = "loop_spin"
FULL = "full"
FULL_ALONE = "full_without_recorder"
PEER = "cyclictest"
TITLES = {
    LOOP_PLAIN: "empty loop, plain sleep",
    LOOP_SPIN: "empty loop, sleep + spin",
    FULL: "control node, whole bench",
    FULL_ALONE: "control node, no recorder",
    PEER: "cyclictest",
}
"""The parts by name, in the order of tables and pictures."""

LONGEST_SLICE_S = 10.0
SHORTEST_PERIOD_S, LONGEST_PERIOD_S = 0.001, 0.1


@dataclass(frozen=True)
class TimingRequest:
    """One call of `hil timing`.

    `duration_s` is measured for every part, cut into `slices`; `spin` is "auto" (what a node chooses by
    itself), "0" (plain sleep only) or microseconds; `priority` 0: SCHED_OTHER.
    """

    scenario: Scenario
    bus: BusOptions
    out: Path
    period_s: float
    duration_s: float
    slices: int
    parts: Sequence[str]
    priority: int = 50
    cpu: int | None = None
    spin: str = "auto"
    load: bool = False
    witness: bool = True
    seed: int = 1

    @property
    def period_ns(self) -> int:
        """Period of loop, nodes and cyclictest [ns]."""
        return round(self.period_s * 1e9)

    @property
    def spin_ns(self) -> int | None:
        """Spin asked for [ns]; None: a node's own choice."""
        return None if self.spin == "auto" else round(float(self.spin) * 1e3)

    @property
    def slice_s(self) -> float:
        """Measured length of one slice [s]."""
        return self.duration_s / self.slices

    @property
    def conditions(self) -> tuple[str, ...]:
        """`idle`, and `load` if asked for."""
        return ("idle", "load") if self.load else ("idle",)

    def turns(self, condition: str) -> list[tuple[str, ...]]:
        """The parts of every round, each round in an order of its own."""
        order = random.Random(f"{self.seed} {condition}")
        return [tuple(order.sample(list(self.parts), len(self.parts))) for _ in range(self.slices)]


def default_slices(duration_s: float) -> int:
    """How many slices a duration is cut into: none longer than 10 s, at least three if they last 1 s."""
    wanted = max(3, -(-duration_s // LONGEST_SLICE_S))
    return int(max(1, min(wanted, duration_s)))


def check(period_s: float, duration_s: float, slices: int | None, spin: str) -> None:
    """Refuse what makes no measurement. Raises ScenarioError with the option, the value and the limit."""
    if not SHORTEST_PERIOD_S <= period_s <= LONGEST_PERIOD_S:
        raise ScenarioError(
            f"--period {period_s:g}: must be {SHORTEST_PERIOD_S:g} to {LONGEST_PERIOD_S:g} s,"
            " the periods that controller and plant can have"
        )
    if not duration_s >= 20 * period_s or duration_s == float("inf"):
        raise ScenarioError(f"--duration {duration_s:g}: must be at least 20 periods, {20 * period_s:g} s")
    if slices is not None and not 1 <= slices <= duration_s / (10 * period_s):
        most = int(duration_s / (10 * period_s))
        raise ScenarioError(f"--slices {slices}: must be 1 to {most}, so that each has ten periods")
    if spin != "auto":
        try:
            micros = float(spin)
        except ValueError:
            raise ScenarioError(f"--spin {spin}: must be auto, 0, or microseconds") from None
        if not 0 <= micros <= period_s * 5e5:
            raise ScenarioError(
                f"--spin {spin}: must be 0 to {period_s * 5e5:g} us, half of the period; or auto"
            )
