import tomllib

import pytest

from hil.bench.scenario import load_scenario
from hil.node.options import parse
from hil.railway.library import list_scenarios


@pytest.fixture
def load(tmp_path):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    return lambda name, *overrides: load_scenario(str(name), overrides, scratch=scratch)


@pytest.mark.parametrize("name", [entry.name for entry in list_scenarios()])
def test_every_shipped_scenario_is_valid_for_every_reader(load, name):
    scenario = load(name)
    assert scenario.name == name
    assert scenario.title


def test_overrides_reach_the_resolved_copy_with_their_type(load, tmp_path):
    scenario = load("cat_linh_la_thanh", "controller.law=pid", "journey.seed=7", "plant.period_s=0.02")
    scenario.write(tmp_path / "copy.toml")
    copy = tomllib.loads((tmp_path / "copy.toml").read_text())
    assert (copy["controller"]["law"], copy["journey"]["seed"], copy["plant"]["period_s"]) == ("pid", 7, 0.02)
    assert (scenario.law, scenario.plant_period_s) == ("pid", 0.02)


@pytest.mark.parametrize("override", ["controller.law", "=3", "a..b=1", "name.deeper=1"])
def test_an_override_without_key_or_value_is_refused(load, override):
    with pytest.raises(ValueError, match="--set"):
        load("cat_linh_la_thanh", override)


def test_an_error_names_the_users_file_not_the_resolved_copy(load, tmp_path):
    mine = tmp_path / "mine.toml"
    shipped = next(entry.path for entry in list_scenarios() if entry.name == "cat_linh_la_thanh")
    mine.write_text(shipped.read_text().replace('law = "fuzzy_d"', 'law = "astrology"'))
    with pytest.raises(ValueError, match="astrology") as caught:
        load(mine)
    assert str(mine) in str(caught.value)
    assert "scratch" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_line_beside_the_scenario_is_found_from_the_resolved_copy(load, tmp_path):
    shipped = next(entry.path for entry in list_scenarios() if entry.name == "cat_linh_la_thanh")
    line = shipped.parent.parent / "lines" / "cat_linh_la_thanh.toml"
    (tmp_path / "line.toml").write_text(line.read_text())
    (tmp_path / "mine.toml").write_text(
        shipped.read_text().replace('line = "cat_linh_la_thanh"', 'line = "line.toml"')
    )
    assert load(tmp_path / "mine.toml").journey.line.name == "cat_linh_la_thanh"


def test_unknown_top_level_table_is_refused(load, tmp_path):
    shipped = next(entry.path for entry in list_scenarios() if entry.name == "cat_linh_la_thanh")
    (tmp_path / "mine.toml").write_text(shipped.read_text() + "\n[controler]\nlaw = 'pid'\n")
    with pytest.raises(ValueError, match="controler"):
        load(tmp_path / "mine.toml")


def test_timing_table_becomes_a_command_line_that_the_nodes_understand(load, tmp_path):
    timing = load(
        "cat_linh_la_thanh", "timing.startup_grace_s=0.5", "timing.max_overloads=7", "timing.spin_us=150",
        "timing.max_consecutive_overloads=2", "timing.rehearsal=false",
    ).timing  # fmt: skip
    options = parse(["--scenario", "x.toml", *timing.arguments()], program="node")
    assert (options.overload_grace_s, options.max_misses, options.max_consecutive_misses) == (0.5, 7, 2)
    assert (options.spin_ns, options.rehearse) == (150_000, False)
    default = parse(["--scenario", "x.toml", *load("cat_linh_la_thanh").timing.arguments()], program="node")
    assert default == parse(["--scenario", "x.toml"], program="node")


@pytest.mark.parametrize(
    "override",
    ["timing.max_overloads=-1", "timing.startup_grace_s=-0.1", "timing.spin_us=often", "timing.x=1"],
)
def test_timing_that_makes_no_sense_names_its_key(load, override):
    with pytest.raises(ValueError, match=override.split("=")[0]) as caught:
        load("cat_linh_la_thanh", override)
    assert caught.value.exit_code == 2
