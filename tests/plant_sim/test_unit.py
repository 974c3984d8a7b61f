"""The plant on the bus: a scripted ATO sends real frames, and real frames come back."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from hil.canbus.contract import Contract
from hil.canbus.protection import Protector, Receiver
from hil.node import Inbox, Outbox
from hil.railway import load_journey
from plant_sim.brakes import BrakeState
from plant_sim.traction import TractionState
from plant_sim.unit import PlantUnit, build

PERIOD_NS = 10_000_000
SCENARIO = """schema = 1
name = "test"
[journey]
line = "{line}"
train = "urban_4car_80m"
from = "Start"
to = "End"
time_s = 250.0
seed = {seed}
"""
SLOPE = """schema = 1
name = "slope"
title = "One slope"
source = "made for this test"
start_m = -200.0
end_m = 1000.0
default_limit_kmh = 54.0
stops = [{{ name = "Start", position_m = 0.0 }}, {{ name = "End", position_m = 900.0 }}]
gradients = [{{ start_m = -200.0, end_m = 1000.0, permille = {permille} }}]
"""


class Bench:
    """Drives one plant in cycles of 10 ms, with the frames that a controller would send."""

    def __init__(self, unit: PlantUnit, contract: Contract) -> None:
        self.unit = unit
        self.contract = contract
        self.inbox = Inbox(contract, unit.receives)
        self.outbox = Outbox(contract, unit.nodes, unit.period_ns)
        self.command = contract.message("ATO_Command")
        assert self.command.protection is not None
        self.protector = Protector(self.command.protection)
        self.cycle = 0
        self.latest: dict[str, dict[str, float]] = {}
        self.events: list[tuple[str, dict[str, float]]] = []
        self.frames: list[tuple[int, bytes]] = []
        self.probes: list[dict[str, float]] = []

    def frame(self, **values: float) -> bytes:
        data = self.command.encode(values)
        self.protector.protect(data)
        return bytes(data)

    def step(self, *frames: bytes, cycles: int = 1) -> dict[str, float]:
        """One cycle with these ATO_Command frames; then so many silent ones that there are `cycles`."""
        for index in range(cycles):
            now_ns = self.cycle * PERIOD_NS
            self.inbox.begin(now_ns)
            for data in frames if index == 0 else ():
                self.inbox.accept(now_ns, self.command.can_id, data)
            self.unit.step(now_ns, self.inbox, self.outbox)
            for can_id, data in self.outbox.collect(self.cycle):
                codec = self.contract.by_id[can_id]
                self.frames.append((can_id, data))
                if codec.cycle_ns is None:
                    self.events.append((codec.name, codec.decode(data)))
                else:
                    self.latest[codec.name] = codec.decode(data)
            names = [probe.name for probe in self.unit.probes]
            self.probes.append(dict(zip(names, self.unit.probe(), strict=True)))
            self.cycle += 1
        return self.probes[-1]

    def drive(self, seconds: float, demand: float, **values: float) -> dict[str, float]:
        for _ in range(round(seconds / 0.01)):
            self.step(self.frame(Mode=2, EffortDemand=demand, HoldingBrake=0, **values))
        return self.probes[-1]


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.load()


@pytest.fixture
def bench(tmp_path: Path, contract: Contract) -> Callable[..., Bench]:
    def build_bench(plant: str = "", *, seed: int = 1, permille: float | None = None) -> Bench:
        line = "fuzzy_d_2km"
        if permille is not None:
            line = "slope.toml"
            (tmp_path / line).write_text(SLOPE.format(permille=permille), encoding="utf-8")
        scenario = tmp_path / "scenario.toml"
        scenario.write_text(SCENARIO.format(line=line, seed=seed) + plant, encoding="utf-8")
        return Bench(build(scenario, contract), contract)

    return build_bench


def test_holding_brake_is_applied_before_the_first_command(bench: Callable[..., Bench]) -> None:
    plant = bench(permille=30.0)
    last = plant.step(cycles=500)
    assert last["position_m"] == 0.0
    assert plant.latest["TCU_Status"]["State"] == TractionState.OFF
    assert plant.latest["BCU_Status"]["State"] == BrakeState.HOLDING
    assert plant.latest["BCU_Status"]["HoldingApplied"] == 1
    assert plant.latest["ODO_Motion"]["Standstill"] == 1
    assert plant.events == []


def test_demand_moves_the_train_and_is_reported(bench: Callable[..., Bench]) -> None:
    plant = bench()
    last = plant.drive(10.0, 0.8)
    assert last["speed_mps"] > 5.0
    assert plant.latest["TCU_Status"]["State"] == TractionState.TRACTION
    assert plant.latest["TCU_Status"]["TractiveEffort"] == pytest.approx(last["traction_effort_n"], abs=10.0)
    assert plant.latest["BCU_Status"]["State"] == BrakeState.RELEASED
    assert plant.latest["ODO_Motion"]["Speed"] == pytest.approx(last["speed_mps"], abs=0.0014)
    plant.drive(3.0, -0.5)
    assert plant.latest["TCU_Status"]["State"] == TractionState.BRAKING
    assert plant.latest["TCU_Status"]["TractiveEffort"] < 0.0
    assert plant.latest["BCU_Status"]["State"] == BrakeState.SERVICE
    assert plant.latest["BCU_Status"]["ElectrodynamicEffort"] > 50_000.0


def test_all_cyclic_messages_and_heartbeats_are_there_and_protected(
    bench: Callable[..., Bench], contract: Contract
) -> None:
    plant = bench()
    plant.drive(5.0, 0.8)
    names = {contract.by_id[can_id].name for can_id, _ in plant.frames}
    wanted = {"TCU_Status", "BCU_Status", "ODO_Motion", "ATP_Permission", "ODO_Balise"}
    assert wanted | {f"{node}_Heartbeat" for node in plant.unit.nodes} <= names
    for name in wanted:
        codec = contract.message(name)
        assert codec.protection is not None
        receiver = Receiver(codec.protection, length=codec.length)
        for can_id, data in plant.frames:
            if can_id == codec.can_id:
                assert receiver.accepted(receiver.check(data))


def test_numbers_of_states_are_those_of_the_value_tables(contract: Contract) -> None:
    for name, states in (("TCU_Status", TractionState), ("BCU_Status", BrakeState)):
        assert dict(contract.message(name).signal("State").choices) == {s.value: s.name for s in states}


def test_traction_is_cut_within_100_ms_of_the_last_command(bench: Callable[..., Bench]) -> None:
    plant = bench()
    before = plant.drive(6.0, 0.8)["traction_effort_n"]
    after = plant.step(cycles=10)
    assert plant.latest["TCU_Status"]["State"] == TractionState.CUT
    assert after["traction_effort_n"] < 0.02 * before
    assert plant.step(cycles=10)["traction_effort_n"] < 0.001 * before


@pytest.mark.parametrize("permille", [-25.0, 0.0, 25.0])
def test_silence_brings_the_train_to_a_stand_and_holds_it(
    bench: Callable[..., Bench], permille: float
) -> None:
    plant = bench(permille=permille)
    assert plant.drive(12.0, 0.9)["speed_mps"] > 6.0
    stood = plant.step(cycles=2500)
    assert plant.latest["BCU_Status"]["State"] == BrakeState.COMMAND_LOST
    assert stood["speed_mps"] == 0.0
    assert plant.step(cycles=3000)["position_m"] == stood["position_m"]
    assert plant.latest["BCU_Status"]["HoldingApplied"] == 1
    assert plant.latest["TCU_Status"]["CommandAge"] == pytest.approx(0.255)
    lost = [(name, values["ErrorCode"]) for name, values in plant.events if name.endswith("Emergency")]
    assert lost == [("TCU_Emergency", 0x8120), ("BCU_Emergency", 0x8120)]


def test_corrupted_commands_count_as_silence(bench: Callable[..., Bench]) -> None:
    plant = bench()
    plant.drive(6.0, 0.8)
    for _ in range(10):
        data = bytearray(plant.frame(Mode=2, EffortDemand=0.8))
        data[3] ^= 0x10
        plant.step(bytes(data))
    assert plant.latest["TCU_Status"]["State"] == TractionState.CUT
    assert plant.latest["TCU_Status"]["CommandStatus"] == 4  # WRONG_CRC
    assert plant.latest["BCU_Status"]["State"] == BrakeState.COMMAND_LOST


def test_frozen_command_counts_as_silence(bench: Callable[..., Bench]) -> None:
    plant = bench()
    plant.drive(6.0, 0.8)
    frozen = plant.frame(Mode=2, EffortDemand=0.8)
    for _ in range(10):
        plant.step(frozen)
    assert plant.latest["BCU_Status"]["State"] == BrakeState.COMMAND_LOST


def test_short_gap_is_bridged(bench: Callable[..., Bench]) -> None:
    plant = bench()
    plant.drive(6.0, 0.8)
    plant.step(cycles=4)
    plant.drive(0.01, 0.8)
    assert plant.latest["TCU_Status"]["State"] == TractionState.TRACTION
    assert not any(name.endswith("Emergency") for name, _ in plant.events)


def test_command_is_trusted_again_after_enough_good_ones(bench: Callable[..., Bench]) -> None:
    plant = bench("[plant.command]\nrecovery_commands = 20\n")
    plant.drive(6.0, 0.8)
    plant.step(cycles=20)
    plant.drive(0.19, 0.5)
    assert plant.latest["BCU_Status"]["State"] == BrakeState.COMMAND_LOST
    plant.drive(0.02, 0.5)
    assert plant.latest["BCU_Status"]["State"] != BrakeState.COMMAND_LOST
    cleared = [(name, values["ErrorCode"]) for name, values in plant.events[-2:]]
    assert cleared == [("TCU_Emergency", 0), ("BCU_Emergency", 0)]
    assert plant.drive(2.0, 0.5)["traction_effort_n"] > 10_000.0


def test_recovery_can_be_bound_to_standstill(bench: Callable[..., Bench]) -> None:
    plant = bench('[plant.command]\nrecovery = "standstill"\n')
    plant.drive(6.0, 0.8)
    plant.step(cycles=20)
    assert plant.drive(1.0, 0.5)["speed_mps"] > 0.0
    assert plant.latest["BCU_Status"]["State"] == BrakeState.COMMAND_LOST
    plant.drive(10.0, 0.0)
    assert plant.latest["BCU_Status"]["State"] != BrakeState.COMMAND_LOST


def test_emergency_brake_cuts_traction_and_stays_until_standstill(bench: Callable[..., Bench]) -> None:
    plant = bench()
    plant.drive(10.0, 0.8)
    plant.drive(0.5, 0.8, EmergencyBrake=1)
    assert plant.latest["TCU_Status"]["State"] == TractionState.CUT
    assert plant.latest["BCU_Status"]["State"] == BrakeState.EMERGENCY
    braked = plant.drive(2.0, 0.8)
    assert plant.latest["BCU_Status"]["EmergencyApplied"] == 1
    train = plant.unit.journey.train
    assert braked["pneumatic_effort_n"] == pytest.approx(train.pneumatic.emergency_effort_n, rel=0.05)
    assert braked["traction_effort_n"] < 100.0
    stopped = plant.drive(8.0, 0.0)
    assert stopped["speed_mps"] == 0.0
    assert plant.latest["BCU_Status"]["State"] != BrakeState.EMERGENCY
    codes = [values["ErrorCode"] for name, values in plant.events if name == "BCU_Emergency"]
    assert codes == [0xFF07, 0]


def test_released_train_rolls_back_but_a_held_one_does_not(bench: Callable[..., Bench]) -> None:
    rolling, held = bench(permille=15.0), bench(permille=15.0)
    assert rolling.drive(6.0, 0.0)["position_m"] < -0.5
    for _ in range(600):
        held.step(held.frame(Mode=4, EffortDemand=0.0, HoldingBrake=1))
    assert held.probes[-1]["position_m"] == 0.0
    assert held.latest["BCU_Status"]["State"] == BrakeState.HOLDING


def test_balises_on_the_bus_are_those_of_the_line(bench: Callable[..., Bench]) -> None:
    plant = bench("[plant.odometry]\nwheel_diameter_error = 0.005\nbalise_error_m = 0.0\n")
    plant.drive(30.0, 0.9)
    passed = plant.probes[-1]["position_m"]
    read = [(v["Number"], v["Position"]) for name, v in plant.events if name == "ODO_Balise"]
    line = plant.unit.journey.line
    assert read == [(b.number, b.position_m) for b in line.balises if b.position_m <= passed]
    last = max(b.position_m for b in line.balises if b.position_m <= passed)
    assert plant.probes[-1]["odometry_error_m"] == pytest.approx(0.005 * (passed - last), abs=1e-6)


def test_speed_and_position_are_rounded_to_the_steps_of_the_contract(bench: Callable[..., Bench]) -> None:
    plant = bench("[plant.odometry]\nwheel_diameter_error = 0.0\nbalise_error_m = 0.0\n")
    worst_speed = worst_position = 0.0
    for _ in range(2000):
        truth = plant.drive(0.01, 0.7)
        motion = plant.latest["ODO_Motion"]
        worst_speed = max(worst_speed, abs(motion["Speed"] - truth["speed_mps"]))
        worst_position = max(worst_position, abs(motion["Position"] - truth["position_m"]))
    assert 0.8 * 0.005 < worst_speed * 3.6 <= 0.005 + 1e-9  # half of 0.01 km/h
    assert 0.8 * 0.0005 < worst_position <= 0.0005 + 1e-9  # half of 1 mm


def test_atp_lets_the_train_go_when_it_is_ready(bench: Callable[..., Bench]) -> None:
    plant = bench("[plant.atp]\ndoors_close_s = 1.0\ndeparture_delay_s = 2.0\n")
    for _ in range(250):
        plant.step(plant.frame(Mode=1, HoldingBrake=1))
        permission = plant.latest.get("ATP_Permission", {"DepartureAuthorised": 0, "DoorsClosed": 0})
        assert permission["DepartureAuthorised"] <= permission["DoorsClosed"]
    assert permission["DepartureAuthorised"] == 1
    assert plant.latest["ATP_Permission"]["PermittedSpeed"] == pytest.approx(15.0, abs=0.002)
    assert plant.latest["ATP_Permission"]["TargetDistance"] == pytest.approx(1000.0, abs=0.06)


def test_same_scenario_and_seed_give_the_same_frames(bench: Callable[..., Bench]) -> None:
    noise = "[plant.odometry]\nspeed_noise_mps = 0.01\nmissed_balise_probability = 0.2\n"

    def frames(seed: int) -> list[tuple[int, bytes]]:
        plant = bench(noise, seed=seed)
        plant.drive(20.0, 0.8)
        plant.drive(5.0, -0.5)
        return plant.frames

    first = frames(1)
    assert frames(1) == first
    assert frames(2) != first


def test_warm_up_changes_nothing(bench: Callable[..., Bench]) -> None:
    warm, cold = bench(), bench()
    warm.unit.warm_up()
    warm.drive(3.0, 0.8)
    cold.drive(3.0, 0.8)
    assert warm.frames == cold.frames


def test_skipped_cycles_are_made_up_for(bench: Callable[..., Bench]) -> None:
    steady, late = bench(), bench()
    steady.drive(5.0, 0.6)
    late.drive(4.0, 0.6)
    late.cycle += 3  # woken three periods late
    late.drive(0.97, 0.6)
    assert late.probes[-1]["position_m"] == pytest.approx(steady.probes[-1]["position_m"], abs=1e-9)


def test_stop_says_traction_off_and_brakes_applied(bench: Callable[..., Bench], contract: Contract) -> None:
    plant = bench()
    plant.drive(8.0, 0.8)
    plant.unit.stop(plant.outbox)
    last = {}
    for can_id, data in plant.outbox.flush():
        last[contract.by_id[can_id].name] = contract.by_id[can_id].decode(data)
    assert last["TCU_Status"]["State"] == TractionState.OFF
    assert last["TCU_Status"]["TractiveEffort"] == 0.0
    assert last["BCU_Status"]["State"] == BrakeState.EMERGENCY
    assert last["BCU_Status"]["EmergencyApplied"] == 1
    assert last["ODO_Motion"]["Valid"] == 0
    assert last["ATP_Permission"]["DepartureAuthorised"] == 0
    assert last["ATP_Permission"]["EmergencyStop"] == 1


def test_probes_are_the_agreed_ones_in_order_and_finite(bench: Callable[..., Bench]) -> None:
    plant = bench()
    assert [probe.name for probe in plant.unit.probes] == [
        "position_m", "speed_mps", "acceleration_mps2", "traction_effort_n", "electrodynamic_effort_n",
        "pneumatic_effort_n", "resistance_n", "permitted_speed_mps", "traction_energy_j",
        "regenerated_energy_j", "odometry_error_m", "command_age_ms",
    ]  # fmt: skip
    plant.drive(5.0, 0.8)
    plant.drive(2.0, -0.8)
    assert all(math.isfinite(value) for probes in plant.probes for value in probes.values())
    assert plant.probes[-1]["regenerated_energy_j"] > 0.0


@pytest.mark.parametrize("name", ["cat_linh_la_thanh", "metro_1500m_disturbed", "mainline_36km"])
def test_every_kind_of_library_scenario_builds(name: str, contract: Contract) -> None:
    from hil.railway.library import find_scenario

    scenario = find_scenario(name)
    unit = build(scenario, contract)
    assert unit.journey == load_journey(scenario)
    plant = Bench(unit, contract)
    assert plant.drive(3.0, 0.8)["speed_mps"] > 0.1


def test_what_exceeds_a_signals_range_is_sent_as_its_limit(bench: Callable[..., Bench]) -> None:
    plant = bench()
    plant.step(cycles=5)
    plant.unit.motion = plant.unit.motion._replace(traction_effort_n=2e6, pneumatic_effort_n=3e6)
    outbox = Outbox(plant.contract, plant.unit.nodes, plant.unit.period_ns)
    plant.unit._put(outbox)
    frames = {can_id: data for cycle in range(10) for can_id, data in outbox.collect(cycle)}
    for name, signal in (("TCU_Status", "TractiveEffort"), ("BCU_Status", "PneumaticEffort")):
        codec = plant.contract.message(name)
        assert codec.decode(frames[codec.can_id])[signal] == codec.signal(signal).si_limits[1]


@pytest.mark.parametrize("period_s", [0.05, 0.1])
def test_a_period_that_lets_the_odometry_time_out_is_bad_input(
    period_s: float, contract: Contract, tmp_path: Path
) -> None:
    from hil.railway import RailwayDataError

    path = tmp_path / "slow.toml"
    path.write_text(f"schema = 1\nname = 'slow'\n[plant]\nperiod_s = {period_s}\n", encoding="utf-8")
    with pytest.raises(RailwayDataError) as error:
        build(path, contract)
    assert str(error.value).startswith(f"{path}: plant.period_s: {period_s:g} ")
    assert "ms of silence for a fault" in str(error.value)
    assert error.value.exit_code == 2
