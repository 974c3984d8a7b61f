"""Fixtures: a line and a train that are easy to reckon with, and files to break on purpose."""

from pathlib import Path

import pytest

from hil.railway import (
    Balise,
    Curve,
    DavisCoefficients,
    EffortCurve,
    ElectrodynamicBrake,
    Gradient,
    Line,
    PneumaticBrake,
    SpeedLimit,
    Stop,
    TractionDrive,
    Train,
    Tunnel,
)

LINE_FILE = """
schema = 1
name = "test_line"
title = "A test line"
source = "made up"
start_m = -100.0
end_m = 1100.0
default_limit_kmh = 72.0

[[stops]]
name = "A"
position_m = 0.0

[[stops]]
name = "B"
position_m = 1000.0

[[speed_limits]]
start_m = 200.0
end_m = 300.0
limit_kmh = 36.0

[[gradients]]
start_m = 400.0
end_m = 500.0
permille = 10.0

[[curves]]
start_m = 450.0
end_m = 650.0
radius_m = 300.0

[[tunnels]]
start_m = 600.0
end_m = 900.0

[[balises]]
number = 1
position_m = 10.0

[[balises]]
number = 2
position_m = 975.0
"""

TRAIN_FILE = """
schema = 1
name = "test_train"
title = "A test train"
source = "made up"
mass_t = 100.0
rotating_mass_factor = 0.1
length_m = 50.0
powered_mass_fraction = 0.5
max_acceleration_mps2 = 1.0
max_braking_mps2 = 1.2
comfort_jerk_mps3 = 0.7

[davis]
a_n = 1000.0
b_n_per_mps = 100.0
c_n_per_mps2 = 4.0

[traction]
max_effort_kn = 110.0
max_power_kw = 1100.0
time_constant_s = 0.4
dead_time_s = 0.1
jerk_limit_mps3 = 1.0

[electrodynamic]
max_effort_kn = 100.0
max_power_kw = 1500.0
time_constant_s = 0.4
dead_time_s = 0.1
jerk_limit_mps3 = 1.0
fade_start_kmh = 7.2
fade_end_kmh = 1.8

[pneumatic]
max_effort_kn = 140.0
emergency_effort_kn = 160.0
holding_effort_kn = 50.0
time_constant_s = 0.6
dead_time_s = 0.2
"""

SCENARIO_FILE = """
schema = 1
name = "test_scenario"

[journey]
line = "line.toml"
train = "train.toml"
from = "A"
to = "B"
time_s = 80.0
seed = 7

[controller]
law = "pid"
"""


@pytest.fixture
def line() -> Line:
    return Line(
        name="test",
        start_m=-100.0,
        end_m=1100.0,
        default_limit_mps=20.0,
        stops=(Stop("A", 0.0), Stop("B", 1000.0)),
        speed_limits=(SpeedLimit(200.0, 300.0, 10.0), SpeedLimit(300.0, 350.0, 15.0)),
        gradients=(Gradient(400.0, 500.0, 10.0), Gradient(500.0, 520.0, -20.0)),
        curves=(Curve(450.0, 650.0, 300.0),),
        tunnels=(Tunnel(600.0, 900.0, 0.5),),
        balises=(Balise(1, 10.0), Balise(2, 975.0)),
    )


@pytest.fixture
def train() -> Train:
    return Train(
        name="test",
        mass_kg=100_000.0,
        rotating_mass_factor=0.1,
        length_m=50.0,
        davis=DavisCoefficients(1000.0, 100.0, 4.0),
        powered_mass_fraction=0.5,
        traction=TractionDrive(EffortCurve(110_000.0, 1_100_000.0), 0.4, 0.1, 1.0),
        electrodynamic=ElectrodynamicBrake(EffortCurve(100_000.0, 1_500_000.0), 0.4, 0.1, 1.0, 2.0, 0.5),
        pneumatic=PneumaticBrake(140_000.0, 0.6, 0.2, 160_000.0, 50_000.0),
        max_acceleration_mps2=1.0,
        max_braking_mps2=1.2,
        comfort_jerk_mps3=0.7,
    )


class Files:
    """A good line, train and scenario in one folder, each of which a test may spoil."""

    def __init__(self, folder: Path) -> None:
        self.line, self.train, self.scenario = (folder / f"{n}.toml" for n in ("line", "train", "scenario"))
        self.line.write_text(LINE_FILE)
        self.train.write_text(TRAIN_FILE)
        self.scenario.write_text(SCENARIO_FILE)

    def spoil(self, path: Path, old: str, new: str) -> Path:
        text = path.read_text()
        assert text.count(old) >= 1, f"{old!r} is not in {path.name}"
        path.write_text(text.replace(old, new, 1))
        return path


@pytest.fixture
def railway_files(tmp_path: Path) -> Files:
    return Files(tmp_path)
