"""docs/performance.md holds what `make bench` measures, all of it, and nothing else."""

from pathlib import Path

import pytest

from benchmarks.__main__ import TITLES
from benchmarks.page import BEGIN, END, write
from benchmarks.rows import Row

ROOT = Path(__file__).parents[2]
ROWS = {"fuzzy": [Row("a step", 2.0, 1000.0, "us", "scikit-fuzzy"), Row("alone", 3.0, None, "us", "-")]}


def test_every_benchmark_has_a_title_and_every_title_its_benchmark():
    helpers = {"__init__", "__main__", "page", "peers", "rows"}
    files = {file.stem for file in (ROOT / "benchmarks").glob("*.py")} - helpers
    assert files == set(TITLES)


def test_the_page_shows_every_benchmark():
    text = (ROOT / "docs/performance.md").read_text()
    shown = [line.split("`")[1] for line in text.splitlines() if line.startswith("### `")]
    assert shown == list(TITLES)


def test_tables_replace_those_of_the_same_benchmark_and_leave_the_rest(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"# Head\n{BEGIN}\n\n### `laws`: older\n\nit stays\n\n{END}\n\nTail\n")
    for _ in range(2):
        write(page, ROWS, {"fuzzy": "one evaluation", "laws": "of every law"})
    text = page.read_text()
    assert text.startswith("# Head\n")
    assert text.endswith("\n\nTail\n")
    assert text.count("### `laws`: older") == 1
    assert "it stays" in text
    assert text.index("### `fuzzy`") < text.index("### `laws`")
    assert text.count("### `fuzzy`: one evaluation") == 1
    assert "| a step | 2 | 1e+03 | 1/500 | us | scikit-fuzzy |" in text
    assert "| alone | 3 | – | – | us | - |" in text


def test_page_without_marks_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Head\n")
    with pytest.raises(ValueError, match="measured: begin"):
        write(page, ROWS, {"fuzzy": ""})
