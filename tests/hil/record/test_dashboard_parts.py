"""Line, law, levels, load, jerk and verdict on the dashboard, each against numbers from elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.fuzzy.bases import fuzzy_d_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.laws import Drive
from controller.laws.selection import LAWS
from controller.picture import law_picture
from hil.bench.metrics import max_jerk_mps3
from hil.canbus.frame import Frame
from hil.canbus.local.bits import INTERFRAME_BITS, frame_bits
from hil.record import RecordError, open_run
from hil.record.about import add_verdict
from hil.record.blocks import decode_block
from hil.record.bus_load import WINDOW_NS, BusLoad
from hil.record.comparison import record_comparison, run_names
from hil.record.dashboard import Chart, Level
from hil.record.derived import Jerk
from hil.record.distance import HEIGHT, WIDTH
from hil.record.law_page import LawPicture, rule_strengths
from hil.record.levels import Levels, known_levels
from hil.record.line_map import LineMap, Track
from hil.record.timelines import Instants


class Paper:
    """A sink that keeps what is drawn."""

    def __init__(self):
        self.drawn, self.moved, self.written = {}, {}, {}

    def drawing(self, entity, strips, color, width=1.0):
        self.drawn[entity] = strips

    def labels(self, entity, places, texts, color):
        self.drawn[entity] = texts

    def moving(self, entity, instants, strips, color, width):
        self.moved.setdefault(entity, []).extend(strips)

    def columns(self, entity, group, instants, columns):
        self.written[entity] = columns


def instants(n, step_ns=10_000_000):
    times = np.arange(n, dtype=np.int64) * step_ns
    return Instants(0, times, np.arange(n), np.zeros(n, np.int64))


def test_the_profile_is_the_integral_of_the_gradients(line):
    at, height = Track.read(line).elevation()
    assert np.interp([50.0, 150.0, 250.0, 400.0], at, height) == pytest.approx([0.0, 2.0, 1.0, 1.0])


def test_the_train_is_drawn_where_its_odometer_says_with_its_length(line):
    paper, track = Paper(), Track.read(line)
    page = LineMap(track, paper)
    page.draw()
    page.move(instants(400), np.linspace(0.0, 350.0, 400))
    bodies = paper.moved["/over_distance/line/train"]
    assert 15 <= len(bodies) <= 25  # 4 s at five a second
    left, right = page.span
    metres = WIDTH / (right - left)
    for body in bodies:
        assert body[-1, 0] - body[0, 0] == pytest.approx(80.0 * metres)
    assert bodies[0][-1, 0] == pytest.approx((0.0 - left) * metres)
    assert paper.drawn["/over_distance/line/names"] == ["A", "B"]
    assert all(0 < strip[:, 1].min() < HEIGHT for strip in paper.drawn["/over_distance/line/profile"])


def test_a_standing_train_is_not_drawn_again(line):
    paper = Paper()
    page = LineMap(Track.read(line), paper)
    for _ in range(3):
        page.move(instants(200), np.full(200, 12.0))
    assert len(paper.moved["/over_distance/line/train"]) == 1


@pytest.mark.parametrize(
    "table", [{"start_m": 0}, {"start_m": 5, "end_m": 5}, [1], {"start_m": "x", "end_m": 2}]
)
def test_a_line_that_cannot_be_drawn_is_one_line_of_text(table):
    with pytest.raises(RecordError, match="track") as caught:
        Track.read(table)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", list(LAWS))
def test_the_inside_of_every_law_can_be_drawn_from_probes_that_it_has(name):
    config = ControllerConfig(law=name)
    picture = LawPicture.read(law_picture(config, Drive()))
    common = {"speed_error_mps", "measured_speed_mps"}
    probes = common | {probe for probe, _ in LAWS[name].make(config, Drive()).probe_names}
    shown = {
        series.sources[0].removeprefix("controller/") for chart in picture.charts for series in chart.series
    }
    shown |= {axis.probe for each in picture.surfaces for axis in (each.error, each.rate)}
    assert shown <= probes
    assert picture.charts
    assert bool(picture.surfaces) == (name not in ("pid", "smc"))


def test_strengths_of_rules_are_those_of_the_controller():
    config = ControllerConfig(law="fuzzy_d")
    surface = LawPicture.read(law_picture(config, Drive())).surfaces[0]
    p = config.fuzzy_d.parameters()
    compiled = CompiledRuleBase(fuzzy_d_rules(p.error_peaks_mps, p.rate_peaks_mps2, p.output_peaks_mps2))
    random = np.random.default_rng(1)
    error, rate = random.uniform(-2, 2, 200), random.uniform(-3, 3, 200)
    expected = [compiled.activations(e, r) for e, r in zip(error, rate, strict=True)]
    np.testing.assert_allclose(rule_strengths(surface, error, rate), expected, atol=1e-12)


def test_jerk_is_that_of_the_verdict_however_the_run_is_cut():
    time_s = np.arange(0.0, 20.0, 0.01)
    acceleration = 0.9 * np.tanh(np.sin(0.7 * time_s) * 3)
    cut = Jerk(0.01)
    jerk = np.concatenate([cut.add(part) for part in np.split(acceleration, [1, 7, 40, 41, 900])])
    assert len(jerk) == len(acceleration)
    assert np.abs(jerk[30:]).max() == pytest.approx(max_jerk_mps3(time_s, acceleration), rel=1e-6)
    np.testing.assert_allclose(Jerk(0.01).add(acceleration), jerk, atol=1e-9)


def test_load_is_the_bits_of_the_frames_over_the_bits_that_fit(contract):
    codec = contract.message("ODO_Motion")
    frames = [Frame(k * 10_000_000, codec.can_id, bytes(8)) for k in range(100)]
    load = BusLoad(500_000)
    ends, percent = [], []
    for begin in range(0, 100, 7):
        part = frames[begin : begin + 7]
        times, columns = load.take(
            part, decode_block(part, contract), np.array([f.timestamp_ns for f in part])
        )
        ends += times.tolist()
        percent += columns.get("load [%]", np.empty(0)).tolist()
    bits = frame_bits(codec.can_id, bytes(8)).total + INTERFRAME_BITS
    assert ends == [(k + 2) * WINDOW_NS for k in range(8)]  # neither the first window nor the last is whole
    assert percent == pytest.approx([100 * 10 * bits / 50_000] * 8)


def test_levels_are_drawn_in_the_unit_of_their_chart_and_unknown_ones_left_out(contract):
    levels = (
        Level("period", "period/controller"),
        Level("jerk", "limits/jerk_mps3"),
        Level("layer", "", 0.3, True),
    )
    chart = Chart("c", "C", "ms", (), levels=levels)
    known = known_levels({"period_us": {"controller": 10_000}, "limits": {"jerk_mps3": 1.0}}, contract)
    assert known["timeout/ODO_Motion"] == (50.0, "ms")
    paper = Paper()
    page = Levels([chart], known, paper)
    page.write(instants(2))
    assert {name: values[0] for name, values in paper.written["/levels/c"].items()} == {
        "period [ms]": 10.0, "layer [ms]": 0.3, "-layer [ms]": -0.3,
    }  # fmt: skip


@pytest.fixture(scope="module")
def two_runs(make_run, tmp_path_factory):
    folders = [tmp_path_factory.mktemp(name) for name in ("one", "two")]
    for seed, folder in enumerate(folders):
        make_run(5.0, seed=seed).record(folder, properties={"law": ("pid", "smc")[seed], "seed": seed})
    return folders


def test_a_verdict_is_added_and_nothing_else_changes(two_runs):
    folder = two_runs[0]
    before = open_run(folder)
    speed, events = before["ODO_Motion.Speed"].values, len(before.events())
    failed = {"name": "jerk", "value": 2.0, "limit": 1.0, "unit": "m/s^3", "passed": False}
    add_verdict(folder / "run.rrd", {"verdict": "failed", "ended": "arrived", "criteria": [failed]})
    after = open_run(folder)
    np.testing.assert_array_equal(after["ODO_Motion.Speed"].values, speed)
    last = after.events()[-1]
    assert len(after.events()) == events + 1
    assert last.text == "verdict: failed; failed: jerk"
    assert last.level == "ERROR"
    assert not [file for file in folder.iterdir() if file.suffix in (".new", ".verdict")]


def test_runs_lie_over_each_other_under_their_own_names(two_runs, tmp_path):
    from rerun.chunk import RrdReader

    names = run_names(two_runs)
    assert ["pid" in names[0], "smc" in names[1]] == [True, True]
    path = record_comparison(two_runs, tmp_path / "compare.rrd")
    entities = {chunk.entity_path for chunk in RrdReader(path).stream()}
    for quantity in ("speed", "speed_error", "demand", "acceleration"):
        assert len([e for e in entities if e.startswith(f"/{quantity}/")]) >= 2
    with pytest.raises(RecordError, match="two runs"):
        record_comparison(two_runs[:1], tmp_path / "x.rrd")
