import pytest

from hil.railway import RailwayDataError, load_journey, scenario_table


def message_of(path) -> str:
    with pytest.raises(RailwayDataError) as caught:
        load_journey(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_journey_has_line_train_stops_time_and_seed(railway_files):
    journey = load_journey(railway_files.scenario)
    assert journey.line.name == "test_line"
    assert journey.train.name == "test_train"
    assert (journey.origin.name, journey.destination.name) == ("A", "B")
    assert journey.distance_m == 1000.0
    assert (journey.time_s, journey.seed) == (80.0, 7)


def test_minimum_time_is_the_permitted_speed_all_the_way(railway_files):
    # 72 km/h, but 36 km/h from 200 m until the rear of the 50 m train has left 300 m
    assert load_journey(railway_files.scenario).minimum_time_s == pytest.approx(850.0 / 20.0 + 150.0 / 10.0)


def test_seed_is_1_unless_given(railway_files):
    assert load_journey(railway_files.spoil(railway_files.scenario, "seed = 7", "")).seed == 1


def test_library_names_work_where_files_do(railway_files):
    path = railway_files.spoil(railway_files.scenario, '"train.toml"', '"urban_4car_80m"')
    assert load_journey(path).train.length_m == 80.0


def test_paths_are_relative_to_the_scenario_and_not_to_where_one_stands(railway_files, tmp_path, monkeypatch):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert load_journey(railway_files.scenario).line.name == "test_line"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("time_s = 80.0", "time_s = 0", "journey.time_s: 0 must be greater than 0.0"),
        (
            "time_s = 80.0",
            "time_s = 57.0",
            "journey.time_s: 57 must be at least 57.5, the time at the permitted speed all the way",
        ),
        ("time_s = 80.0", "time_s = nan", "journey.time_s: nan must be a finite number"),
        ("seed = 7", "seed = -1", "journey.seed: -1 must be at least 0"),
        (
            "seed = 7",
            "sed = 7",
            "journey.sed: unknown key; did you mean seed? it has line, train, from, to, time_s, seed",
        ),
        ('from = "A"', "", "journey.from: is missing"),
        ('from = "A"', 'from = "C"', "journey.from: line test_line: no stop 'C'; it has 'A', 'B'"),
        ('to = "B"', 'to = "b"', "journey.to: line test_line: no stop 'b'; it has 'A', 'B'"),
        (
            'to = "B"',
            'to = "A"',
            "journey.to: 'A' at 0 m must lie beyond 'A' at 0 m; a line file has one direction of travel",
        ),
        ("[journey]", "[jorney]", "journey: is missing; a scenario needs the table [journey]"),
        ('"line.toml"', '"lane.toml"', "journey.line: lane.toml: no such line file"),
    ],
)
def test_a_wrong_journey_is_explained_in_one_line(railway_files, old, new, message):
    path = railway_files.spoil(railway_files.scenario, old, new)
    assert message_of(path) == f"{path}: {message}"


def test_an_unknown_library_name_lists_what_there_is(railway_files):
    path = railway_files.spoil(railway_files.scenario, '"line.toml"', '"cat_lin_la_thanh"')
    message = message_of(path)
    assert (
        "journey.line: no line 'cat_lin_la_thanh' in the library; did you mean cat_linh_la_thanh?" in message
    )
    assert "fuzzy_d_2km" in message


def test_an_error_in_the_line_names_the_line_file(railway_files):
    railway_files.spoil(railway_files.line, "limit_kmh = 36.0", "limit_kmh = -1.0")
    assert message_of(railway_files.scenario).startswith(
        f"{railway_files.line}: speed_limits#1.limit_kmh: -1.0"
    )


def test_tables_are_given_raw_and_a_missing_one_is_empty(railway_files):
    assert scenario_table(railway_files.scenario, "controller") == {"law": "pid"}
    assert scenario_table(railway_files.scenario, "plant") == {}


def test_a_value_where_a_table_belongs_is_named(railway_files):
    with pytest.raises(RailwayDataError, match=r"scenario\.toml: name: 'test_scenario' must be a table"):
        scenario_table(railway_files.scenario, "name")
