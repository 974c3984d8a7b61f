"""`hil study` as a user types it."""

import json
import subprocess
import sys

import pytest


def hil(*arguments: str, cwd=None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "hil", *arguments], capture_output=True, text=True, timeout=120, cwd=cwd
    )


def test_without_a_name_the_studies_are_listed(tmp_path):
    done = hil("study", "--json", cwd=tmp_path)
    assert done.returncode == 0
    listed = [study["name"] for study in json.loads(done.stdout)["studies"]]
    assert listed == ["fuzzy_d", "fsmc", "fuzzy_pid", "dynamic_programming"]
    assert list(tmp_path.iterdir()) == [], "a list writes nothing"


def test_an_unknown_study_is_one_line_with_a_suggestion_and_exit_code_2(tmp_path):
    done = hil("study", "fuzy_d", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.splitlines() == ["hil: no study 'fuzy_d': did you mean fuzzy_d?"]
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    out = tmp_path_factory.mktemp("study") / "out"
    return out, hil("study", "fsmc", "--json", "--out", str(out))


def test_a_study_prints_exactly_one_json_document_and_writes_the_same(finished):
    out, done = finished
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document == json.loads((out / "study.json").read_text())
    assert document["study"] == "fsmc"
    keys = {"quantity", "unit", "paper", "ours", "reproduced", "note"}
    assert all(keys <= set(row) for row in document["rows"])
    assert any(row["reproduced"] is False for row in document["rows"]), "which is no failure"
    assert "sample times" in done.stderr, "progress goes elsewhere"


def test_every_figure_is_a_picture_and_table_and_recording_lie_beside(finished):
    out, done = finished
    names = {path.name for path in out.iterdir()}
    figures = json.loads(done.stdout)["figures"]
    assert len(figures) == 20
    assert names == {*figures, "study.json", "study.csv", "study.rrd"}
    assert all((out / name).stat().st_size > 10_000 for name in figures)


def test_a_study_is_not_written_over_another(finished):
    out, _ = finished
    done = hil("study", "fsmc", "--out", str(out))
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "already holds a study" in done.stderr


def test_the_table_has_a_line_for_every_row_and_every_contradiction(tmp_path):
    done = hil("study", "fuzzy_pid", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (run,) = (tmp_path / "runs").iterdir()
    assert run.name.endswith("-study-fuzzy_pid")
    document = json.loads((run / "study.json").read_text())
    text = " ".join(done.stdout.split())
    for sentence in (*document["contradictions"], *document["assumptions"]):
        assert sentence in text
    assert text.count("RMS error") >= 9
    assert "nothing to judge" in text
