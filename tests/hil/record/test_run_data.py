"""A recording answers by signal name: every sample, exact stamps, one time base by holding values."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
import pytest
import rerun.blueprint as rrb

from hil.record import NotRecorded, Recorder, RecorderOptions, RecordingUnreadable, RunData, open_run
from hil.record.column_store import StoredColumns
from hil.record.compact import compact
from hil.record.rerun_sink import RerunSink
from hil.record.timelines import Instants


@pytest.fixture(scope="module")
def recorded(make_run, tmp_path_factory):
    run = make_run(8.0)
    folder = tmp_path_factory.mktemp("asked")
    run.record(folder)
    return run, folder


def sent(run, name):
    can_id = run.contract.message(name).can_id
    return [frame for frame in run.frames if frame.can_id == can_id]


def test_a_column_has_every_sample_at_its_exact_time(recorded):
    run, folder = recorded
    data = open_run(folder)
    frames = sent(run, "ODO_Motion")
    speed = data["ODO_Motion.Speed"]
    assert isinstance(data, RunData)
    assert speed.unit == "km/h"
    assert len(speed) == len(frames)
    assert speed.bus_time_ns.tolist() == [frame.timestamp_ns for frame in frames]
    codec = run.contract.message("ODO_Motion")
    place = [signal.name for signal in codec.signals].index("Speed")
    matrix = np.frombuffer(b"".join(f.data for f in frames), np.uint8).reshape(len(frames), -1)
    np.testing.assert_array_equal(speed.values, codec.decode_columns(matrix)[:, place])


def test_probes_are_columns_and_a_slash_is_as_good_as_a_dot(recorded):
    run, folder = recorded
    data = open_run(folder)
    true = data["plant_sim/speed_mps"]
    np.testing.assert_array_equal(true.values, [row[-6] for row in run.rows["plant_sim"]])
    assert true.unit == "m/s"
    assert "plant_sim.speed_mps" in data
    assert "plant_sim/nothing" not in data


def test_cycles_hold_timing_and_probes_of_every_cycle(recorded):
    run, folder = recorded
    cycles = open_run(folder).cycles("controller")
    assert cycles.num_rows == len(run.rows["controller"])
    assert cycles["cycle"].to_pylist() == [row[0] for row in run.rows["controller"]]
    latency = [(row[2] - row[1]) / 1e3 for row in run.rows["controller"]]
    np.testing.assert_array_equal(cycles["wakeup_latency_us"].to_numpy(), latency)
    np.testing.assert_array_equal(cycles["integral"].to_numpy(), [row[-1] for row in run.rows["controller"]])


def test_signals_are_listed_with_unit_and_count(recorded):
    run, folder = recorded
    listed = {info.name: info for info in open_run(folder).signals}
    assert (listed["ODO_Motion.Speed"].unit, listed["ODO_Motion.Speed"].samples) == (
        "km/h",
        len(sent(run, "ODO_Motion")),
    )
    assert listed["SYNC.Tick"].samples == 0
    assert listed["controller.wakeup_latency_us"].unit == "us"


def test_a_table_holds_each_value_until_the_next_as_pandas_does(recorded):
    pandas = pytest.importorskip("pandas")
    data = open_run(recorded[1])
    names = ["ODO_Motion.Speed", "ATO_Status.ReferenceSpeed", "plant_sim.speed_mps"]
    ours = data.to_pandas(names)
    for name in names[1:]:
        left, right = (
            pandas.DataFrame({"t": data[n].bus_time_ns, n: data[n].values}) for n in (names[0], name)
        )
        np.testing.assert_array_equal(ours[name].to_numpy(), pandas.merge_asof(left, right, on="t")[name])
    on_times = data.to_arrow(names, on=np.array([0.0, 1.0, 2.0]))
    assert on_times.num_rows == 3
    assert data.to_arrow(names, on="ATO_Status.Mode").num_rows == len(data["ATO_Status.Mode"])


def test_a_state_has_its_words(recorded):
    mode = open_run(recorded[1])["ATO_Status.Mode"]
    assert mode.choices
    assert set(mode.names()) <= set(mode.choices.values())


def test_an_unknown_name_says_which_are_near(recorded):
    with pytest.raises(NotRecorded, match=r"nearest: ODO_Motion\.Speed"):
        open_run(recorded[1])["ODO_Motion.Sped"]
    with pytest.raises(NotRecorded, match=r"plant_sim\.speed_mps"):
        open_run(recorded[1])["plant.speed_mps"]


def test_the_frame_log_alone_gives_the_same_signals(recorded, tmp_path):
    run, folder = recorded
    (tmp_path / "frames.blf").write_bytes((folder / "frames.blf").read_bytes())
    whole, log = open_run(folder), open_run(tmp_path)
    assert "frame log" in log.warning
    for name in ("ODO_Motion.Speed", "ATO_Status.Mode", "BCU_Status.PneumaticEffort"):
        np.testing.assert_array_equal(log[name].values, whole[name].values)
        # python-can holds times as epoch seconds in a float: to a quarter of a microsecond
        assert np.max(np.abs(log[name].bus_time_ns - whole[name].bus_time_ns)) <= 1000
    assert len(list(log.frames)) == len(run.frames)


def test_the_tables_beside_a_recording_are_plain_parquet(recorded):
    run, folder = recorded
    table = pq.read_table(folder / "columns" / "bus.ODO_Motion.parquet")
    assert table.column_names[:4] == ["bus_time", "sim_time", "cycle", "position"]
    assert table.num_rows == len(sent(run, "ODO_Motion"))
    assert "Speed [km/h]" in table.column_names


def test_a_recording_alone_says_that_only_drawn_samples_are_there(recorded, tmp_path):
    _, folder = recorded
    (tmp_path / "run.rrd").write_bytes((folder / "run.rrd").read_bytes())
    alone = open_run(tmp_path)
    assert "columns/ is not beside it" in alone.warning
    drawn, all_of_it = alone["ODO_Motion.Speed"], open_run(folder)["ODO_Motion.Speed"]
    assert 10 < len(drawn) < len(all_of_it) / 3
    assert set(drawn.bus_time_ns) <= set(all_of_it.bus_time_ns)
    line = np.interp(all_of_it.sim_time_s, drawn.sim_time_s, drawn.values)
    assert np.max(np.abs(line - all_of_it.values)) < 0.05 * np.ptp(all_of_it.values)


def test_asked_not_to_thin_the_recording_keeps_everything(make_run, tmp_path):
    run = make_run(2.0)
    with Recorder(run.contract, RecorderOptions(tmp_path, thin=False)) as recorder:
        run.play(recorder, {})
    assert not (tmp_path / "columns").exists()
    assert len(open_run(tmp_path)["ODO_Motion.Speed"]) == len(sent(run, "ODO_Motion"))


def test_a_damaged_table_is_an_error_of_one_line(recorded, tmp_path):
    _, folder = recorded
    (tmp_path / "columns").mkdir()
    (tmp_path / "run.rrd").write_bytes((folder / "run.rrd").read_bytes())
    (tmp_path / "columns" / "bus.ODO_Motion.parquet").write_bytes(b"no table")
    with pytest.raises(RecordingUnreadable, match="not a readable table") as damaged:
        open_run(tmp_path)["ODO_Motion.Speed"]
    assert "\n" not in str(damaged.value)


def test_a_column_that_came_later_has_its_own_samples_only(tmp_path):
    """A chart may gain a column while the run goes on: its first pieces lack it."""
    start = 1_790_000_000_000_000_000
    sink = RerunSink(
        tmp_path / "run.rrd", recording_id="x", name="x", blueprint=rrb.Blueprint(), viewer_url=None
    )
    for block in range(3):
        places = np.arange(block * 10, block * 10 + 10)
        instants = Instants(start, start + places * 1_000_000, places, places)
        columns = {"old": places * 1.0} | ({"new": places * 2.0} if block else {})
        sink.columns("/bus/M", "M", instants, columns)
        sink.flush()
    sink.close()
    compact(tmp_path / "run.rrd", rrb.Blueprint)
    stored = StoredColumns(tmp_path / "columns")
    assert stored.read("/bus/M", ["cycle", "old"])["old"].tolist() == list(range(30))
    found = stored.read("/bus/M", ["cycle", "new"])
    assert found["cycle"].tolist() == list(range(10, 30))
    assert found["new"].tolist() == [2.0 * k for k in range(10, 30)]
