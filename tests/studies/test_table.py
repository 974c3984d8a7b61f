"""The table judges by declared tolerances; the registry finds studies by name."""

import csv
import json
import math

import numpy as np
import pyarrow.compute as pc
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import RrdReader

from studies.errors import StudyError
from studies.figure import Figure, Line, Panel, thin
from studies.registry import STUDIES, entry
from studies.report import write
from studies.study import Study, study_json
from studies.table import Row, Tolerance, summary_line

finite = st.floats(-1e6, 1e6)


@given(paper=finite, relative=st.floats(0.0, 1.0), absolute=st.floats(0.0, 1e3), share=st.floats(0.0, 0.999))
def test_what_is_within_either_tolerance_is_reproduced_and_what_is_beyond_both_is_not(
    paper, relative, absolute, share
):
    tolerance = Tolerance(relative=relative, absolute=absolute)
    most = max(relative * abs(paper), absolute)
    assert Row("q", "m", paper, paper + share * most, tolerance).reproduced
    assert not Row("q", "m", paper, paper + most + 1e-6 * (1.0 + abs(paper) + most), tolerance).reproduced


@pytest.mark.parametrize(
    ("paper", "ours", "tolerance"),
    [(None, 1.0, Tolerance(0.1)), (1.0, None, Tolerance(0.1)), (1.0, 1.0, None)],
)
def test_a_row_without_both_numbers_and_a_tolerance_is_not_judged(paper, ours, tolerance):
    assert Row("q", "m", paper, ours, tolerance).reproduced is None


def test_a_number_that_is_none_is_never_reproduced():
    assert Row("q", "m", 1.0, math.nan, Tolerance(relative=1e9)).reproduced is False


def test_a_negative_tolerance_is_refused():
    with pytest.raises(ValueError, match=r"relative -0\.1"):
        Tolerance(relative=-0.1)


def test_the_ratio_to_a_paper_s_zero_is_left_out():
    assert Row("q", "m", 0.0, 3.0).ratio is None
    assert Row("q", "m", 2.0, 3.0).ratio == 1.5


def test_the_summary_counts_what_was_judged_only():
    rows = [
        Row("a", "m", 1.0, 1.0, Tolerance()),
        Row("b", "m", 1.0, 2.0, Tolerance(0.1)),
        Row("c", "m", None, 2.0),
    ]
    assert summary_line(rows) == "1 of 2 numbers reproduced"


def test_every_listed_study_is_found_and_a_near_miss_names_it():
    assert [entry(name).name for name in STUDIES] == list(STUDIES)
    with pytest.raises(StudyError, match="did you mean fsmc") as caught:
        entry("fscm")
    assert caught.value.exit_code == 2
    with pytest.raises(StudyError, match="there are fuzzy_d"):
        entry("42")


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=400), st.integers(10, 80))
def test_thinning_keeps_ends_and_extremes_and_the_order(values, most):
    y = np.array(values)
    x = np.arange(len(y), dtype=float)
    few_x, few_y = thin(x, y, most)
    assert len(few_x) <= most + 4 or len(few_x) == len(x)
    assert (few_y.min(), few_y.max()) == (y.min(), y.max())
    assert (few_x[0], few_x[-1]) == (x[0], x[-1])
    assert np.all(np.diff(few_x) > 0)
    np.testing.assert_array_equal(y[few_x.astype(int)], few_y)


def small_study() -> Study:
    x = np.linspace(0.0, 10.0, 50)
    over_time = Panel(
        "Speed, first", "speed [m/s]", [Line("law", "a", x, x**2), Line("vd", "reference", x, x)]
    )
    over_distance = Panel("Speed", "speed [m/s]", [Line("law", "b", 100.0 * x, x)])
    return Study(
        "small",
        "A small study",
        "a paper",
        [Row("q", "m", 1.0, 1.04, Tolerance(0.05), "near", "group"), Row("r", "m", None, math.inf)],
        ["It contradicts itself."],
        ["It says nothing of this."],
        [
            Figure("fig1", "One", "time_s", "time [s]", [over_time], "Fig. 1"),
            Figure("fig2", "Two", "position_m", "position [m]", [over_distance]),
            Figure("fig3", "Three", "other", "s [m/s]", [over_distance]),
        ],
    )


def test_a_study_is_written_as_pictures_json_csv_and_recording(tmp_path):
    files = write(small_study(), tmp_path)
    assert sorted(file.name for file in files) == sorted(file.name for file in tmp_path.iterdir())
    for name in ("fig1.png", "fig2.png", "fig3.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    document = json.loads((tmp_path / "study.json").read_text())
    assert document == study_json(small_study())
    assert document["rows"][0]["reproduced"] is True
    assert document["rows"][1]["ours"] is None, "JSON knows no infinity"
    with (tmp_path / "study.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["quantity"] for row in rows] == ["q", "r"]
    assert rows[0]["tolerance"] == "5 %"


def test_the_recording_holds_the_series_of_the_figures(tmp_path):
    write(small_study(), tmp_path)
    series, timelines = {}, {}
    for chunk in RrdReader(tmp_path / "study.rrd").stream():
        batch = chunk.to_record_batch()
        if "Scalars:scalars" in batch.schema.names:
            values = pc.list_flatten(batch.column("Scalars:scalars")).to_numpy(zero_copy_only=False)
            series[chunk.entity_path] = values
            timelines[chunk.entity_path] = {"sim_time", "position"} & set(batch.schema.names)
    assert timelines == {
        "/fig1/Speed_first/law": {"sim_time"},
        "/fig1/Speed_first/vd": {"sim_time"},
        "/fig2/Speed/law": {"position"},
    }, "a figure over something else has no timeline"
    np.testing.assert_allclose(series["/fig1/Speed_first/law"], np.linspace(0.0, 10.0, 50) ** 2)
