"""The report says everything a run left, and says what it did not leave."""

import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace
from urllib.parse import unquote

import numpy as np
import pytest

from hil.bench.errors import ScenarioError
from hil.bench.report import write_comparison, write_report
from hil.bench.report.events import event_rows
from hil.bench.report.source import open_source
from hil.record import RunEvent


class FakeRecording(dict):
    """As much of a recording as the list of events asks for."""

    def __init__(self, events, plans):
        super().__init__({"controller.plan_number": plans})
        self.events = lambda: events


VOID = {"meta", "link", "br", "path", "img"}


class Page(HTMLParser):
    """Structure of a page: text, tags, addresses; complains about tags that do not close."""

    def __init__(self, path):
        super().__init__()
        self.text, self.tags, self.addresses, self.ids, self._open, self._quiet = "", [], [], [], [], False
        self.feed(path.read_text(encoding="utf-8"))
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.tags.append((tag, given))
        self.addresses += [given[key] for key in ("href", "src", "data", "srcset") if key in given]
        self.ids += [given["id"]] if "id" in given else []
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self._open.pop()

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if "style" not in self._open:
            self.text += data


def test_the_run_has_written_its_report(recorded):
    page = Page(recorded / "report.html")
    for title in (
        "Criteria",
        "Speed over distance",
        "Gradient",
        "Effort",
        "Tracking error",
        "Jerk",
        "Timing",
        "Bus",
    ):
        assert title in page.text
    assert page.text.index("Passed") < page.text.index("Criteria") < page.text.index("Speed over distance")
    summary = json.loads((recorded / "summary.json").read_text())
    assert page.text.count("✓ passed") + page.text.count("△ marginal") >= len(summary["criteria"])
    assert summary["environment"]["kernel"] in page.text
    assert "Cat Linh" in page.text


def test_one_file_of_moderate_size_that_loads_nothing(recorded):
    path = recorded / "report.html"
    page = Page(path)
    assert path.stat().st_size < 1_000_000
    assert not {"script", "iframe", "object", "img"} & {tag for tag, _ in page.tags}
    assert "url(" not in path.read_text()
    assert "@import" not in path.read_text()
    assert not any(
        re.match(r"[a-z]+:|//", address) for address in page.addresses if not address.startswith("data:")
    )


def test_links_lead_to_the_files_of_the_run(recorded, tmp_path):
    for out in (recorded / "report.html", tmp_path / "mail" / "a report.html"):
        write_report(recorded, out)
        linked = [
            unquote(address) for address in Page(out).addresses if not address.startswith(("#", "data:"))
        ]
        assert {"run.rrd", "frames.blf", "summary.json", "junit.xml"} <= {
            link.split("/")[-1] for link in linked
        }
        assert all((out.parent / link).is_file() for link in linked)


def test_text_of_the_scenario_is_text(recorded):
    source = (recorded / "report.html").read_text()
    assert "<script" not in source.lower()
    assert "<script>alert(1)</script> & “co”" in Page(recorded / "report.html").text


def test_every_picture_and_table_says_what_it_is(recorded):
    page = Page(recorded / "report.html")
    pictures = [given for tag, given in page.tags if tag == "svg" and given.get("role") == "img"]
    assert len(pictures) >= 7
    for given in pictures:
        assert given["aria-labelledby"] in page.ids
        assert given["aria-describedby"] in page.ids
    assert len(set(page.ids)) == len(page.ids)
    tags = [tag for tag, _ in page.tags]
    assert tags.count("caption") == tags.count("table") > 4


def test_failed_and_marginal_criteria_are_marked(run, spoil):
    def change(summary):
        rows = {row["name"]: row for row in summary["criteria"]}
        rows["stop_error"] |= {"value": -0.4, "passed": False}
        rows["jerk"] |= {"value": 0.8 * rows["jerk"]["limit"], "passed": True}
        rows["trip_time_error"] |= {"value": None, "passed": False}
        summary |= {"verdict": "failed"}

    text = Page(write_report(spoil(run, change)).path).text
    assert "✗ Failed" in text
    assert "2 of 9 criteria not met: Stop error and Trip time error." in text
    assert "Marginal, at 80\u00a0% of the limit or more: Largest jerk." in text
    assert "−0.400" in text
    assert "not reached or not known" in text


def test_an_aborted_run_says_why(run, spoil):
    why = "interrupted <by the user>"
    spoil(run, lambda summary: summary.update(verdict="aborted", ended="aborted", ended_because=why))
    text = Page(write_report(run).path).text
    assert "■ Aborted" in text
    assert f"did not arrive: {why}." in text


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("frames.blf", "frames.blf is not there"),
        ("summary.json", "summary.json is not there: the run was not judged"),
        ("scenario.toml", "line, limits and stations are not drawn"),
        ("run.rrd", "No recording"),
    ],
)
def test_what_is_missing_is_said(run, name, told):
    (run / name).unlink()
    if name == "run.rrd":
        (run / "frames.blf").unlink()
    written = write_report(run)
    text = Page(written.path).text
    assert any(told in line for line in written.missing)
    assert told in text
    assert "not there" in text


def test_a_damaged_recording_and_summary_leave_a_report(run):
    (run / "run.rrd").write_bytes(b"no recording")
    (run / "summary.json").write_text("{")
    written = write_report(run)
    assert len(written.missing) == 2
    assert "No verdict" in Page(written.path).text


def test_lockstep_says_that_there_is_no_wakeup_latency(recorded):
    assert "no schedule to be late for" in Page(recorded / "report.html").text


def test_limits_of_real_time_stand_beside_the_percentiles(run, spoil):
    def change(summary):
        summary["mode"] = "real-time"
        for timing in summary["timing"].values():
            timing["rights"] = {
                "sched_fifo": {
                    "name": "sched_fifo",
                    "state": "refused",
                    "detail": "EPERM",
                    "remedy": "ulimit -r 99",
                }
            }

    text = Page(write_report(spoil(run, change)).path).text
    assert re.search(r"(above|within) 400", text)
    assert "Remedy: ulimit -r 99" in text
    assert "controller: wake-up latency" in text


def test_runs_are_compared(recorded, run, spoil, tmp_path):
    def change(summary):
        summary.update(law="pid", seed=2)
        summary["criteria"][0]["value"] += 0.01

    spoil(run, change)
    (run / "scenario.toml").write_text(
        (run / "scenario.toml").read_text().replace("time_s = 88.0", "time_s = 90.0")
    )
    written = write_comparison([recorded, run], tmp_path / "out" / "comparison.html")
    page = Page(written.path)
    assert written.verdicts == ("passed", "passed")
    assert "+0.0100" in page.text
    for different in ("journey.time_s", "seed", "law"):
        assert different in page.text
    assert "time_s" not in page.text.replace("journey.time_s", "")
    assert "Difference of the speeds at the same place" in page.text
    assert (
        (written.path.parent / next(a for a in page.addresses if a.endswith("report.html")))
        .resolve()
        .is_file()
    )


def test_a_run_without_recording_is_compared_by_its_numbers(recorded, run, tmp_path):
    for name in ("run.rrd", "frames.blf"):
        (run / name).unlink()
    written = write_comparison([run, recorded], tmp_path / "c.html")
    assert any(line.startswith("run: No recording can be read") for line in written.missing)
    assert "Largest jerk" in Page(written.path).text


def test_where_there_is_no_run_nothing_is_written(tmp_path):
    with pytest.raises(ScenarioError, match="no run there"):
        write_report(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_report_that_cannot_be_written_leaves_nothing_behind(run):
    out = run / "taken"
    (out / "inside").mkdir(parents=True)
    with pytest.raises(ScenarioError, match="cannot be written"):
        write_report(run, out)
    assert not list(run.glob(".taken*"))


def test_a_report_is_the_same_when_it_is_made_again(recorded, tmp_path):
    copy = shutil.copytree(recorded, tmp_path / recorded.name)
    assert write_report(copy).path.read_text() == write_report(copy).path.read_text()


def test_new_plans_are_told_and_what_is_sent_again_is_told_once(run):
    source = open_source(run)
    plans = SimpleNamespace(sim_time_s=np.arange(4.0), values=np.array([0.0, 0.0, 1.0, 1.0]))
    order = "ATP_Restriction: Number 0, Start 600 m"
    events = [RunEvent(t, "INFO", "ATP", order) for t in (1.0, 2.0, 3.0)] + [
        RunEvent(4.0, "WARN", "TCU", "slip")
    ]
    fake = replace(source, recording=FakeRecording(events, plans))
    told = [(row.time_s, row.text) for row in event_rows(fake) if not row.minor]
    assert told == [(1.0, order), (2.0, "re-planned: plan 1 in force"), (4.0, "slip")]
