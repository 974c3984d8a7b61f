"""The table [plant]: defaults, and errors that name file, key, value and limit in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.railway import RailwayDataError
from plant_sim.config import PlantConfig


def written(folder: Path, text: str) -> Path:
    path = folder / "my.toml"
    path.write_text('schema = 1\nname = "my"\n' + text, encoding="utf-8")
    return path


def test_scenario_without_the_table_gets_the_defaults(tmp_path: Path) -> None:
    config = PlantConfig.load(written(tmp_path, ""))
    assert config == PlantConfig()
    assert (config.substeps, config.period_ns) == (10, 10_000_000)


def test_values_are_read_from_all_tables(tmp_path: Path) -> None:
    text = (
        "[plant]\nperiod_s = 0.02\nsubstep_s = 0.0005\npoint_mass = true\n[plant.train]\nmass_factor = 1.2\n"
        "[plant.odometry]\nmissed_balise_probability = 0.5\n[plant.atp]\noverlap_m = 5\n"
        '[plant.command]\nlost_brake = "emergency"\n'
    )
    config = PlantConfig.load(written(tmp_path, text))
    assert (config.substeps, config.point_mass, config.train.mass_factor) == (40, True, 1.2)
    assert config.odometry.missed_balise_probability == 0.5
    assert (config.atp.overlap_m, config.command.lost_brake) == (5.0, "emergency")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[plant]\nperiod_s = 0", ("plant.period_s", "0", "0.001")),
        ("[plant]\nsubstep_s = 0.003", ("plant.substep_s", "0.003", "period_s = 0.01")),
        ("[plant]\nperiod_s = 0.0105", ("plant.substep_s", "0.001", "period_s = 0.0105")),
        ("[plant]\nperoid_s = 0.01", ("plant.peroid_s", "unknown key")),
        ("[plant.train]\nmass_factor = -1.0", ("plant.train.mass_factor", "-1.0", "greater than 0")),
        ("[plant.train]\nadhesion = 'wet'", ("plant.train.adhesion", "wet", "number")),
        (
            "[plant.odometry]\nmissed_balise_probability = 1.5",
            ("missed_balise_probability", "1.5", "at most 1"),
        ),
        ("[plant.disturbance]\namplitude_mps2 = -0.1", ("plant.disturbance.amplitude_mps2", "-0.1", "0")),
        ("[plant.disturbance]\nfrequency_hz = 1.0", ("plant.disturbance.frequency_hz", "unknown key")),
        (
            "[plant.train]\nfriction_brake_factor = 0.0",
            ("plant.train.friction_brake_factor", "0.0", "greater"),
        ),
        ("[plant.atp]\nbraking_factor = nan", ("plant.atp.braking_factor", "nan")),
        ("[plant.command]\nlost_brake = 'none'", ("plant.command.lost_brake", "none", "service")),
    ],
)
def test_error_is_one_line_with_file_key_value_and_limit(
    tmp_path: Path, text: str, words: tuple[str, ...]
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(RailwayDataError) as raised:
        PlantConfig.load(path)
    message = str(raised.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for word in words:
        assert word in message
    assert raised.value.exit_code == 2
