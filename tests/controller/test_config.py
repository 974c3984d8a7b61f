from __future__ import annotations

import pytest
from pydantic import ValidationError

from controller.config import ControllerConfig
from controller.fuzzy.bases import fuzzy_d_rules
from controller.laws.selection import LAWS
from hil.railway import RailwayDataError


def test_everything_has_a_default(scenario_file):
    assert ControllerConfig.load(scenario_file("")) == ControllerConfig()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[controller]\nperiod_s = 0", "controller.period_s: 0 must be greater than 0"),
        ("[controller]\nperiod_s = nan", "controller.period_s: nan must be a finite number"),
        ("[controller]\nlaw = 'lqr'", "controller.law: 'lqr' must be 'fuzzy_d', 'pid'"),
        ("[controller]\nperiode_s = 0.01", "controller.periode_s: unknown key; did you mean period_s?"),
        ("[controller]\nlaw = 3", "controller.law: 3 must be 'fuzzy_d', 'pid'"),
        ("[controller.pid]\nkp_per_s = -1.0", "controller.pid.kp_per_s: -1.0 must be at least 0"),
        ("[controller.pid]\nkp_per_s = '2'", "controller.pid.kp_per_s: '2' must be a number"),
        ("[controller.fuzzy_d]\nerror_peaks_mps = [1.0, 0.5]", "error_peaks_mps [1.0, 0.5] must ascend"),
        ("[controller.fuzzy_d]\nerror_peaks_mps = [1.0]", "controller.fuzzy_d.error_peaks_mps#2: is missing"),
        (
            "[controller.profile]\nbraking_mps2 = 9.0",
            "controller.profile.braking_mps2: 9.0 must be at most 2",
        ),
        (
            "[controller.supervision]\noverspeed_brake_mps = 0.2",
            "overspeed_brake_mps 0.2 must be greater than overspeed_warning_mps = 0.4",
        ),
        ("controller = 3", "controller: 3 must be a table"),
    ],
)
def test_a_wrong_table_is_one_line_with_file_key_value_and_limit(tmp_path, text, message):
    path = tmp_path / "my.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RailwayDataError) as error:
        ControllerConfig.load(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert error.value.exit_code == 2


def test_configuration_is_frozen():
    with pytest.raises(ValidationError):
        ControllerConfig().law = "pid"


def test_values_reach_the_laws(scenario_file):
    text = "[controller.fuzzy_d]\nerror_peaks_mps = [0.4, 0.9]\ngain = 2\n[controller.pid]\nkp_per_s = 1.5\n"
    config = ControllerConfig.load(scenario_file(text))
    assert config.fuzzy_d.parameters().error_peaks_mps == (0.4, 0.9)
    assert config.fuzzy_d.parameters().gain == 2.0
    assert config.pid.parameters().kp_per_s == 1.5


def test_the_defaults_of_the_laws_are_stated_once():
    config = ControllerConfig()
    assert config.fuzzy_d.parameters() == type(config.fuzzy_d.parameters())()
    assert config.pid.parameters() == type(config.pid.parameters())()


def test_valid_fuzzy_peaks_make_a_valid_rule_base():
    p = ControllerConfig().fuzzy_d.parameters()
    fuzzy_d_rules(p.error_peaks_mps, p.rate_peaks_mps2, p.output_peaks_mps2)


def test_every_law_of_the_configuration_can_be_made_and_has_its_number_on_the_bus(contract):
    config = ControllerConfig()
    signals = {signal.name: signal for signal in contract.message("ATO_Status").signals}
    for name, entry in LAWS.items():
        assert signals["Law"].choices[entry.number] == name.upper()
        assert config.model_copy(update={"law": name}) is not None
        assert entry.make(config).probe_names
