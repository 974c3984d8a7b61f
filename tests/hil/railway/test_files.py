"""Every error of a file is one line with file, key, value and limit."""

from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field, ValidationError, model_validator

from hil.railway import RailwayDataError, load_line, load_train
from hil.railway.files import FileModel, describe_validation_error, read_toml, validate


def message_of(load, path: Path) -> str:
    with pytest.raises(RailwayDataError) as caught:
        load(path)
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.exit_code == 2
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


def test_good_files_load_with_si_inside(railway_files):
    line = load_line(railway_files.line)
    assert line.default_limit_mps == pytest.approx(20.0)
    assert line.speed_limit_mps(250.0) == pytest.approx(10.0)
    assert line.tunnels[0].resistance_n_per_kn == pytest.approx(0.00013 * 300.0)
    assert line.curve_coefficient == 600.0
    train = load_train(railway_files.train)
    assert train.mass_kg == 100_000.0
    assert train.traction.curve.max_power_w == 1.1e6
    assert train.electrodynamic.fade_start_mps == pytest.approx(2.0)
    assert train.pneumatic.holding_effort_n == 50_000.0


def test_both_forms_of_davis_coefficients_load(railway_files):
    specific = (
        "[specific_davis]\na_n_per_kn = 1.75\nb_n_per_kn_per_kmh = 0.0234\nc_n_per_kn_per_kmh2 = 0.000184"
    )
    railway_files.spoil(
        railway_files.train, "[davis]\na_n = 1000.0\nb_n_per_mps = 100.0\nc_n_per_mps2 = 4.0", specific
    )
    force_n = load_train(railway_files.train).running_resistance_n(15.0)
    assert force_n == pytest.approx((1.75 + 0.0234 * 54 + 0.000184 * 54**2) * 981.0)


def test_effort_points_load_in_si(railway_files):
    points = "points = [{ speed_kmh = 0, effort_kn = 90.0 }, { speed_kmh = 36, effort_kn = 45.0 }]"
    railway_files.spoil(railway_files.train, "max_effort_kn", f"{points}\nmax_effort_kn")
    assert load_train(railway_files.train).traction_effort_n(5.0) == pytest.approx(67_500.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("limit_kmh = 36.0", "limit_kmh = 0.0", "speed_limits#1.limit_kmh: 0.0 must be greater than 0.0"),
        ("limit_kmh = 36.0", "limit_kmh = -5.0", "speed_limits#1.limit_kmh: -5.0 must be greater than 0.0"),
        ("limit_kmh = 36.0", "limit_kmh = nan", "speed_limits#1.limit_kmh: nan must be a finite number"),
        ("limit_kmh = 36.0", "limit_kmh = inf", "speed_limits#1.limit_kmh: inf must be a finite number"),
        ("limit_kmh = 36.0", 'limit_kmh = "36"', "speed_limits#1.limit_kmh: '36' must be a number"),
        ("limit_kmh = 36.0", "limit_kmh = true", "speed_limits#1.limit_kmh: true must be a number"),
        (
            "limit_kmh = 36.0",
            "limit_mps = 10.0",
            "speed_limits#1.limit_kmh: is missing (and 1 more error)",
        ),
        (
            "limit_kmh = 36.0",
            "limit_kmh = 36.0\nlimit_mph = 2.0",
            "speed_limits#1.limit_mph: unknown key; did you mean limit_kmh? it has start_m, end_m, limit_kmh",
        ),
        (
            "default_limit_kmh = 72.0",
            "default_limit_kmh = 0",
            "default_limit_kmh: 0 must be greater than 0.0",
        ),
        ("end_m = 300.0", "end_m = 200.0", "speed_limits#1.end_m: 200 must be greater than start_m = 200"),
        ("end_m = 1100.0", "end_m = -100.0", "end_m: -100 must be greater than start_m = -100"),
        ("permille = 10.0", "permille = 1000.0", "gradients#1.permille: 1000.0 must be at most 100.0"),
        ("radius_m = 300.0", "radius_m = 0.0", "curves#1.radius_m: 0.0 must be at least 10.0"),
        ("number = 2", "number = 1", "balises#2: 1 is there twice; each must be unique"),
        ("number = 2", "number = 70000", "balises#2.number: 70000 must be at most 65535"),
        ("number = 2", "number = 1.5", "balises#2.number: 1.5 must be a whole number"),
        (
            "position_m = 1000.0",
            "position_m = 2000.0",
            "stops#2.position_m: 2000 (B) must lie on the line, -100 to 1100 m",
        ),
        ('name = "B"', 'name = "A"', "stops#2: A is there twice; each must be unique"),
        (
            "[[curves]]",
            "[[gradients]]\nstart_m = 490.0\nend_m = 510.0\npermille = 1.0\n[[curves]]",
            "gradients: 490 to 510 m overlaps 400 to 500 m; sections of one kind must not overlap",
        ),
        (
            "[[gradients]]",
            "[[speed_limits]]\nstart_m = 150.0\nend_m = 201.0\nlimit_kmh = 9.0\n[[gradients]]",
            "speed_limits: 200 to 300 m overlaps 150 to 201 m; sections of one kind must not overlap",
        ),
        ("end_m = 900.0", "end_m = 1900.0", "tunnels#1: 600 to 1900 m must lie on the line, -100 to 1100 m"),
        ("schema = 1", "schema = 2", "schema: 2 must be at most 1"),
        ("schema = 1", "", "schema: is missing"),
        ('source = "made up"', 'source = ""', "source: '' must have a length of at least 1"),
        ('name = "test_line"', 'name = "a b"', "name: 'a b' must match ^[A-Za-z0-9_-]+$"),
        (
            '[[stops]]\nname = "B"\nposition_m = 1000.0\n',
            "",
            "stops: must have at least 2 entries, has 1",
        ),
        ("[[tunnels]]", "[tunnels]", "tunnels: {'start_m': 600.0, 'end_m': 900.0} must be a list"),
    ],
)
def test_a_wrong_line_file_is_explained_in_one_line(railway_files, old, new, message):
    assert message_of(load_line, railway_files.spoil(railway_files.line, old, new)) == message


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mass_t = 100.0", "mass_t = -100.0", "mass_t: -100.0 must be greater than 0.0"),
        ("mass_t = 100.0", "", "mass_t: is missing"),
        (
            "rotating_mass_factor = 0.1",
            "rotating_mass_factor = 1.08",
            "rotating_mass_factor: 1.08 must be at most 0.5",
        ),
        (
            "powered_mass_fraction = 0.5",
            "powered_mass_fraction = 50",
            "powered_mass_fraction: 50 must be at most 1.0",
        ),
        ("a_n = 1000.0", "a_n = -1.0", "davis.a_n: -1.0 must be at least 0.0"),
        (
            "[davis]\na_n = 1000.0\nb_n_per_mps = 100.0\nc_n_per_mps2 = 4.0",
            "",
            "davis: exactly one of [davis] and [specific_davis] must be there, not none",
        ),
        (
            "[davis]",
            "[specific_davis]\na_n_per_kn = 1\nb_n_per_kn_per_kmh = 1\nc_n_per_kn_per_kmh2 = 1\n[davis]",
            "davis: exactly one of [davis] and [specific_davis] must be there, not both",
        ),
        ("[traction]", "[tracktion]", "traction: is missing (and 1 more error)"),
        (
            "max_effort_kn = 110.0",
            "max_effort_kn = 0.0",
            "traction.max_effort_kn: 0.0 must be greater than 0.0",
        ),
        (
            "max_power_kw = 1100.0",
            "points = [{speed_kmh = 36, effort_kn = 9}, {speed_kmh = 18, effort_kn = 8}]",
            "points: speed 5 m/s follows 10 m/s; speeds must ascend",
        ),
        (
            "fade_end_kmh = 1.8",
            "fade_end_kmh = 9.0",
            "electrodynamic: fade start 2 m/s must be greater than fade end 2.5 m/s",
        ),
        (
            "max_effort_kn = 140.0",
            "max_effort_kn = 100.0",
            "pneumatic.max_effort_kn: 100 must be at least 132.0, the effort of max_braking_mps2 = 1.2",
        ),
        (
            "time_constant_s = 0.6",
            "time_constant_s = -0.6",
            "pneumatic.time_constant_s: -0.6 must be at least 0.0",
        ),
    ],
)
def test_a_wrong_train_file_is_explained_in_one_line(railway_files, old, new, message):
    assert message_of(load_train, railway_files.spoil(railway_files.train, old, new)) == message


def test_a_missing_file_is_named(tmp_path):
    assert message_of(read_toml, tmp_path / "none.toml") == "no such file"


def test_a_folder_is_no_file(tmp_path):
    assert message_of(read_toml, tmp_path).startswith("cannot be read: ")


@pytest.mark.parametrize("text", ["", "\n\n", "# only a comment\n"])
def test_an_empty_file_is_named(tmp_path, text):
    path = tmp_path / "empty.toml"
    path.write_text(text)
    assert message_of(read_toml, path) == "is empty"


def test_a_syntax_error_comes_with_its_line_number(railway_files):
    railway_files.spoil(railway_files.line, "start_m = -100.0", "start_m = = 3")
    message = message_of(read_toml, railway_files.line)
    assert message.startswith("not valid TOML: ")
    assert "line 6" in message


def test_text_that_is_not_utf8_is_named(tmp_path):
    path = tmp_path / "latin.toml"
    path.write_bytes(b'title = "caf\xe9"\n')
    assert message_of(read_toml, path) == "not UTF-8 text (byte 12)"


class Inner(FileModel):
    kind: Literal["a", "b"] = "a"
    flag: bool = False


class Outer(FileModel):
    inner: Inner = Inner()
    optional: Inner | None = None
    number: Annotated[int, Field(lt=10)] = 1
    names: list[str] = Field(default_factory=list)

    @model_validator(mode="after")
    def _check(self):
        if self.number == 7:
            raise ValueError("number 7 is\n taken")
        return self


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"inner": {"kind": "c"}}, "t.toml: controller.inner.kind: 'c' must be 'a' or 'b'"),
        ({"inner": {"flag": 1}}, "t.toml: controller.inner.flag: 1 must be true or false"),
        ({"inner": 5}, "t.toml: controller.inner: 5 must be a table"),
        ({"number": 10}, "t.toml: controller.number: 10 must be less than 10"),
        ({"number": 7}, "t.toml: controller: number 7 is taken"),
        ({"names": ["a", 3]}, "t.toml: controller.names#2: 3 must be text"),
        ({"names": "x" * 99}, "t.toml: controller.names: '" + "x" * 56 + "... must be a list"),
        (
            {"inner": {"knd": 1}},
            "t.toml: controller.inner.knd: unknown key; did you mean kind? it has kind, flag",
        ),
        (
            {"optional": {"zzz": 1}},
            "t.toml: controller.optional.zzz: unknown key; it has kind, flag",
        ),
        (
            {"number": 11, "names": 3, "inner": 4},
            "t.toml: controller.inner: 4 must be a table (and 2 more errors)",
        ),
    ],
)
def test_any_table_of_any_room_is_explained_the_same_way(tables, message):
    with pytest.raises(RailwayDataError) as caught:
        validate(Outer, tables, Path("t.toml"), "controller")
    assert str(caught.value) == message


def test_description_works_without_prefix_and_without_model():
    with pytest.raises(ValidationError) as caught:
        Outer.model_validate({"numbr": 1})
    assert describe_validation_error(caught.value, "t.toml") == "t.toml: numbr: unknown key"
