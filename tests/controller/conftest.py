"""A small, fast train that answers the unit in memory: dead times, lags, jerk limit, quantised speed.

It is written for these tests alone, apart from the bench's own plant, so that the two check each other.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.planning import plan
from controller.unit import ControllerUnit
from hil.canbus.contract import Contract
from hil.node.inbox import CycleTiming
from hil.railway import Journey, load_journey
from hil.railway.library import find_scenario

PERIOD_S = 0.01
PERIOD_NS = 10_000_000
SPEED_STEP_MPS = 0.01 / 3.6


class Message:
    """What `hil.node.inbox.Received` shows to a unit."""

    def __init__(self, **values: float) -> None:
        self.values: dict[str, float] = dict(values)
        self.received = True
        self.fresh = True
        self.faulty = False
        self.silent = False
        self.counter = 0
        self.events: list[dict[str, float]] = []

    def timed_out(self) -> bool:
        return self.silent

    def age_ns(self) -> int:
        return 0

    @property
    def valid(self) -> bool:
        return self.received and not self.silent and not self.faulty


class Bus:
    """Stands for inbox and outbox at once."""

    def __init__(self) -> None:
        self.messages = {
            "TCU_Status": Message(State=1, TractiveEffort=0.0),
            "BCU_Status": Message(State=1, PneumaticEffort=0.0),
            "ODO_Motion": Message(Valid=1, Standstill=1, Slip=0, Slide=0, Speed=0.0, Position=0.0),
            "ODO_Balise": Message(Number=0, Position=0.0),
            "ATP_Permission": Message(
                DoorsClosed=1, DepartureAuthorised=1, EmergencyStop=0, PermittedSpeed=30.0
            ),
            "ATP_Restriction": Message(Number=0, Start=0.0, Length=0.0, Limit=0.0),
        }
        self.timing = CycleTiming()
        self.sent: dict[str, Mapping[str, float]] = {}
        self.events: list[tuple[str, Mapping[str, float]]] = []

    def __getitem__(self, name: str) -> Message:
        return self.messages[name]

    def worst_age_ns(self) -> int:
        return 0

    def put(self, name: str, values: Mapping[str, float]) -> None:
        self.sent[name] = values

    def event(self, name: str, values: Mapping[str, float]) -> None:
        self.events.append((name, values))

    @property
    def command(self) -> Mapping[str, float]:
        return self.sent["ATO_Command"]


@dataclass
class TestTrain:
    """Deviations of the true train from the one that the controller knows."""

    __test__ = False
    mass_factor: float = 1.0
    brake_factor: float = 1.0
    traction_factor: float = 1.0
    lag_s: float = 0.4
    dead_time_s: float = 0.1
    jerk_mps3: float = 1.0
    friction_lag_s: float = 0.6
    friction_dead_time_s: float = 0.2
    lost_fraction: float = 0.0
    seed: int = 0


@dataclass
class Run:
    """Time series of one closed-loop run (truth, not measurement) and what the bus ended with."""

    time_s: np.ndarray
    position_m: np.ndarray
    speed_mps: np.ndarray
    acceleration_mps2: np.ndarray
    permitted_mps: np.ndarray
    reference_mps: np.ndarray
    mode: np.ndarray
    demand: np.ndarray
    holding: np.ndarray
    supervision: np.ndarray
    stop_m: float
    bus: Bus = field(repr=False)

    @property
    def driving(self) -> np.ndarray:
        return (self.mode == 2) | (self.mode == 3)

    @property
    def stop_error_m(self) -> float:
        return float(self.position_m[-1] - self.stop_m)

    @property
    def rms_error_mps(self) -> float:
        error = (self.reference_mps - self.speed_mps)[self.driving]
        return float(np.sqrt(np.mean(error**2)))

    @property
    def overspeed_mps(self) -> float:
        return float(np.max(self.speed_mps - self.permitted_mps))

    @property
    def jerk_mps3(self) -> float:
        """0.2 s moving average of the acceleration, differenced over 0.1 s; the standstill included."""
        average = np.convolve(self.acceleration_mps2, np.full(20, 0.05), mode="valid")
        return float(np.max(np.abs(average[10:] - average[:-10])) / 0.1)

    @property
    def standstill_index(self) -> int:
        return int(np.flatnonzero(self.speed_mps > 0.005)[-1]) + 1

    @property
    def standstill_mps2(self) -> float:
        return float(abs(self.acceleration_mps2[self.standstill_index - 1]))

    @property
    def trip_time_s(self) -> float:
        return float(self.time_s[self.standstill_index] - self.time_s[self.driving][0])


class Loop:
    """The unit against the small train, cycle by cycle."""

    def __init__(self, journey: Journey, unit: ControllerUnit, true: TestTrain) -> None:
        self.journey, self.unit, self.true = journey, unit, true
        self.bus = Bus()
        self.cycle = 0
        self.position_m = journey.origin.position_m
        self.speed_mps = 0.0
        self.acceleration_mps2 = 0.0
        train = journey.train
        self._limited_mps2 = self._drive_mps2 = 0.0
        self._holding_mps2 = train.pneumatic.holding_effort_n / train.effective_mass_kg
        self._friction_mps2 = self._friction_limited_mps2 = self._holding_mps2
        self._random = np.random.default_rng(true.seed)
        self._orders: deque[float] = deque([0.0] * round(true.dead_time_s / PERIOD_S))
        self._friction: deque[float] = deque(
            [self._holding_mps2] * round(true.friction_dead_time_s / PERIOD_S)
        )
        self._balises = [b for b in journey.line.balises if b.position_m > self.position_m]
        self.rows: list[tuple[float, ...]] = []

    def step(self) -> None:
        self._measure()
        self.unit.step(self.cycle * PERIOD_NS, self.bus, self.bus)  # type: ignore[arg-type]
        command = self.bus.command
        permitted = self.bus["ATP_Permission"].values["PermittedSpeed"]
        probe = self.unit.probe()
        self.rows.append(
            (
                self.cycle * PERIOD_S, self.position_m, self.speed_mps, self.acceleration_mps2, permitted,
                probe[0], command["Mode"], command["EffortDemand"], command["HoldingBrake"], probe[8],
            )
        )  # fmt: skip
        self._move(command)
        self.cycle += 1

    def run(self, seconds: float, each: Callable[[Loop], None] | None = None) -> Run:
        """Until the train has been in HOLD for two seconds, at most so long."""
        held = 0
        for _ in range(round(seconds / PERIOD_S)):
            if each is not None:
                each(self)
            self.step()
            held = held + 1 if self.rows[-1][6] == 4 else 0
            if held > 200:
                break
        columns = np.array(self.rows, dtype=float).T
        return Run(*columns, stop_m=self.journey.destination.position_m, bus=self.bus)

    def _measure(self) -> None:
        motion = self.bus["ODO_Motion"]
        motion.fresh = self._random.random() >= self.true.lost_fraction
        if motion.fresh:
            motion.values["Speed"] = round(self.speed_mps / SPEED_STEP_MPS) * SPEED_STEP_MPS
            motion.values["Position"] = round(self.position_m, 3)
            motion.values["Standstill"] = int(self.speed_mps == 0.0)
        mass = self.journey.train.effective_mass_kg
        self.bus["TCU_Status"].values["TractiveEffort"] = self._drive_mps2 * mass
        self.bus["BCU_Status"].values["PneumaticEffort"] = self._friction_mps2 * mass
        line, train = self.journey.line, self.journey.train
        if self.cycle % 10 == 0:
            limit = line.speed_limit_mps(self.position_m, train.length_m)
            self.bus["ATP_Permission"].values["PermittedSpeed"] = limit
        balise = self.bus["ODO_Balise"]
        balise.events.clear()
        while self._balises and self.position_m >= self._balises[0].position_m:
            passed = self._balises.pop(0)
            balise.events.append({"Number": passed.number, "Position": passed.position_m})

    def _move(self, command: Mapping[str, float]) -> None:
        true, train, line = self.true, self.journey.train, self.journey.line
        mass = train.effective_mass_kg * true.mass_factor
        demand = -1.0 if command["EmergencyBrake"] else command["EffortDemand"]
        full = train.max_braking_mps2
        # The friction brake is ordered what the motors will not be able to give when it has come.
        ahead = true.friction_dead_time_s + 2.0 * true.friction_lag_s
        later = max(0.0, self.speed_mps + min(0.0, demand) * full * ahead)
        motors = train.electrodynamic.effort_n(later) / train.effective_mass_kg
        order = max(0.0, -demand * full - motors)
        if command["HoldingBrake"]:
            order = max(order, self._holding_mps2)
        self._friction.append(order)
        step = true.jerk_mps3 * PERIOD_S
        if self.speed_mps == 0.0:
            step *= 5.0  # at a stand nobody feels it
        ordered = self._friction.popleft() - self._friction_limited_mps2
        self._friction_limited_mps2 += min(step, max(-step, ordered))
        missing = self._friction_limited_mps2 - self._friction_mps2
        self._friction_mps2 += missing * PERIOD_S / true.friction_lag_s
        self._orders.append(demand)
        demand = self._orders.popleft()
        target = train.effort_n(demand, self.speed_mps) / train.effective_mass_kg
        if demand < 0.0:
            now = train.electrodynamic.effort_n(self.speed_mps) / train.effective_mass_kg
            target = -min(max(0.0, -target - self._friction_mps2), now)
        self._limited_mps2 += min(step, max(-step, target - self._limited_mps2))
        self._drive_mps2 += (self._limited_mps2 - self._drive_mps2) * PERIOD_S / true.lag_s
        nominal = train.effective_mass_kg / mass
        pull = max(0.0, self._drive_mps2) * true.traction_factor * nominal
        brake = (max(0.0, -self._drive_mps2) + self._friction_mps2) * true.brake_factor * nominal
        specific = line.mean_specific_resistance(self.position_m, train.length_m)
        slope = specific * 9.81e-3 * train.mass_kg / train.effective_mass_kg
        davis = train.running_resistance_n(self.speed_mps) / mass
        before = self.speed_mps
        if before == 0.0 and abs(pull - slope) <= brake + davis:
            self.acceleration_mps2 = 0.0
            return
        direction = 1.0 if before > 0.0 or (before == 0.0 and pull > slope) else -1.0
        rate = pull - slope - direction * (brake + davis)
        after = before + rate * PERIOD_S
        if before * after < 0.0:
            after = 0.0
        self.position_m += 0.5 * (before + after) * PERIOD_S
        self.speed_mps = after
        self.acceleration_mps2 = rate


@pytest.fixture(scope="session")
def contract() -> Contract:
    return Contract.load()


@pytest.fixture(scope="session")
def journeys() -> dict[str, Journey]:
    names = ("cat_linh_la_thanh", "fuzzy_d_2km", "la_thanh_cat_linh", "metro_1500m")
    return {name: load_journey(find_scenario(name)) for name in names}


@pytest.fixture(scope="session")
def configs() -> dict[str, ControllerConfig]:
    names = ("cat_linh_la_thanh", "fuzzy_d_2km", "la_thanh_cat_linh", "metro_1500m")
    return {name: ControllerConfig.load(find_scenario(name)) for name in names}


@pytest.fixture(scope="session")
def loop(
    contract: Contract, journeys: dict[str, Journey], configs: dict[str, ControllerConfig]
) -> Callable[..., Loop]:
    """`loop(scenario, law="fuzzy_d", mass_factor=1.2)`: the unit of a scenario against the small train."""
    profiles = {name: plan(journeys[name], configs[name]) for name in journeys}

    def make(scenario: str = "cat_linh_la_thanh", *, law: str = "fuzzy_d", **true: float) -> Loop:
        journey = journeys[scenario]
        config = configs[scenario].model_copy(update={"law": law})
        unit = ControllerUnit(journey, config, profiles[scenario], contract)
        return Loop(journey, unit, TestTrain(**true))  # type: ignore[arg-type]

    return make


@pytest.fixture
def bus() -> Bus:
    return Bus()


@pytest.fixture
def tools() -> SimpleNamespace:
    """The classes above, for tests that build their own."""
    return SimpleNamespace(Bus=Bus, Loop=Loop, TestTrain=TestTrain, period_ns=PERIOD_NS)


@pytest.fixture
def scenario_file(tmp_path: Path) -> Callable[[str], Path]:
    """Write a scenario file: the Cat Linh journey and whatever follows."""

    def write(text: str, *, time_s: float = 88.0) -> Path:
        path = tmp_path / "my.toml"
        path.write_text(
            "schema = 1\nname = 'my'\n[journey]\nline = 'cat_linh_la_thanh'\ntrain = 'cat_linh_4car'\n"
            f"from = 'Cat Linh'\nto = 'La Thanh'\ntime_s = {time_s}\n{text}",
            encoding="utf-8",
        )
        return path

    return write
