"""timing.json as a reader of cyclictest's JSON takes it, the picture and the recording."""

from __future__ import annotations

import json
import shutil
import subprocess
from datetime import UTC, datetime

import numpy as np
import pytest

from hil.bench.timing.document import as_document
from hil.bench.timing.limits import judge, load_limits
from hil.bench.timing.picture import draw
from hil.bench.timing.recording import record
from hil.bench.timing.samples import spread

NOW = datetime(2026, 1, 1, tzinfo=UTC)


@pytest.fixture
def document(campaign):
    rows = judge(load_limits(), campaign.measured)
    made = as_document(campaign, rows, [], started=NOW, ended=NOW, command=["hil", "timing"])
    return json.loads(json.dumps(made))


@pytest.mark.skipif(
    shutil.which("cyclictest") is None, reason="cyclictest is not installed (Debian package rt-tests)"
)
def test_the_top_level_has_the_keys_and_types_that_cyclictest_writes(document, tmp_path):
    file = tmp_path / "c.json"
    line = ["cyclictest", "-q", "-p0", "--policy=other", "-i1000", "-l20", "-h1000", f"--json={file}"]
    subprocess.run(line, check=True, capture_output=True)
    theirs = json.loads(file.read_text())
    assert set(theirs) <= set(document)
    assert {key: type(value) for key, value in theirs.items()} == {key: type(document[key]) for key in theirs}
    assert set(theirs["sysinfo"]) <= set(document["sysinfo"])
    assert set(theirs["thread"]["0"]) <= set(document["thread"]["0"])


def test_each_part_is_a_thread_whose_histogram_has_every_cycle(document, campaign):
    assert document["num_threads"] == len(document["thread"]) == 4
    for thread in document["thread"].values():
        assert sum(thread["histogram"].values()) == thread["cycles"] == 4000
        known = campaign.measured[thread["condition"], thread["name"]].wakeup_latency_us
        assert thread["max"] == int(known.max())


def test_our_own_part_says_what_the_measurement_says(document, campaign):
    own = document["hil"]
    assert own["verdict"] == "passed"
    assert document["return_code"] == 0
    full = own["conditions"]["idle"]["parts"]["full"]
    whole = spread(campaign.measured["idle", "full"].wakeup_latency_us)
    assert full["wakeup_latency_us"]["p99"] == pytest.approx(whole.p99, abs=1e-3)
    assert full["ratio_to_cyclictest"]["p99"] < 0.25
    assert set(full["execution_split_us"]) == {"read", "step", "send"}
    assert full["deadlines"]["unseen"] == 0
    error = campaign.measured["idle", "full"].values("period_error_us")
    assert full["period_error_us"]["absolute"]["max"] == pytest.approx(np.abs(error).max(), abs=1e-3)


def test_picture_and_recording_are_written(campaign, tmp_path):
    assert draw(campaign, load_limits(), tmp_path).read_bytes().startswith(b"\x89PNG")
    assert record(campaign, tmp_path, "| a |").read_bytes().startswith(b"RRF")
