"""compare.rrd: one recording, one time axis, the same entities for every law."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from hil.bench.compare import Comparison, Request
from hil.bench.comparison_recording import QUANTITIES, outline, record_comparison
from hil.bench.contender import Contender
from hil.bench.metrics import ControlMetrics
from hil.bench.sets import NOMINAL
from hil.bench.trial import Lines, TrialResult

TIME_S = np.arange(0.0, 5.0, 0.01)


@pytest.fixture(scope="module")
def entities(tmp_path_factory):
    folder: Path = tmp_path_factory.mktemp("rrd")
    pid, paper = Contender("pid"), Contender("pid", "paper")
    comparison = Comparison(Request("made_up", (pid, paper)))
    for gain, contender in ((1.0, pid), (0.9, paper)):
        speed = gain * TIME_S
        lines = Lines(TIME_S, 0.5 * speed * TIME_S, speed, TIME_S, np.full(len(TIME_S), gain), 1e3 * speed)
        comparison.add(TrialResult(contender, NOMINAL, "", ControlMetrics(*(None,) * 9), lines=lines))
    path = record_comparison(comparison, folder, "| a table |")
    found = defaultdict(list)
    for chunk in RrdReader(path).stream():
        found[chunk.entity_path].append(chunk)
    return found


def test_every_law_has_the_same_four_quantities_and_the_reference_is_there_once(entities):
    expected = {f"/{quantity}/{law}" for quantity in QUANTITIES for law in ("pid", "pid_paper")}
    plotted = {
        name for name in entities if name.startswith(tuple(f"/{quantity}/" for quantity in QUANTITIES))
    }
    assert plotted == expected | {"/speed/reference"}
    assert "/table" in entities


def test_values_are_on_the_axis_of_time_and_that_of_position(entities):
    batches = [chunk.to_record_batch() for chunk in entities["/speed/pid_paper"] if not chunk.is_static]
    times = np.concatenate([b.column("sim_time").cast("int64").to_numpy() for b in batches]) * 1e-9
    values = np.concatenate(
        [b.column("Scalars:scalars").flatten().to_numpy(zero_copy_only=False) for b in batches]
    )
    assert times == pytest.approx(TIME_S, abs=1e-9)
    assert values == pytest.approx(3.6 * 0.9 * TIME_S)
    assert all("position" in batch.schema.names for batch in batches)


def test_an_outline_keeps_ends_and_the_width_of_chatter():
    chatter = np.where(np.arange(50_000) % 2 == 0, -1.0, 1.0)
    chatter[12_345] = 9.0
    rows = outline(chatter, 1000)
    assert len(rows) <= 1002
    assert np.all(np.diff(rows) > 0)
    assert (rows[0], rows[-1]) == (0, 49_999)
    assert 12_345 in rows
    for part in np.array_split(chatter[rows], 20):
        assert part.min() == -1.0
        assert part.max() >= 1.0
    assert outline(chatter[:500], 1000).tolist() == list(range(500))
