"""Bad input: one clear line, exit code 2 or 3, never a traceback."""

from pathlib import Path

import pytest
from e2e_support import hil, one_line

import hil.library as shipped

SCENARIO = """
schema = 1
name = "mine"
[journey]
line = "{line}"
train = "{train}"
from = "Cat Linh"
to = "La Thanh"
time_s = 90.0
seed = 1
{more}
"""


@pytest.fixture
def scenario(tmp_path):
    def write(line="cat_linh_la_thanh", train="cat_linh_4car", more=""):
        path = tmp_path / "mine.toml"
        path.write_text(SCENARIO.format(line=line, train=train, more=more))
        return str(path)

    return write


def fails(*arguments, code=2, cwd=None):
    done = hil(*arguments, cwd=cwd, timeout_s=60)
    assert done.returncode == code, done.stdout + done.stderr
    return one_line(done.stderr)


def test_unknown_key_names_file_and_key(scenario, tmp_path):
    line = fails("run", scenario(more="[controller]\nlaaw = 'pid'"), "--out", str(tmp_path / "o"))
    assert "mine.toml" in line
    assert "controller.laaw" in line


def test_value_out_of_range_names_key_value_and_limit(scenario, tmp_path):
    line = fails("run", scenario(more="[controller]\nperiod_s = 0.0"), "--out", str(tmp_path / "o"))
    assert "controller.period_s" in line
    assert "greater than 0" in line


def test_negative_mass_is_refused(scenario, tmp_path):
    text = (Path(shipped.__file__).parent / "trains" / "cat_linh_4car.toml").read_text()
    lines = ["mass_t = -5.0" if line.startswith("mass_t") else line for line in text.splitlines()]
    (tmp_path / "heavy.toml").write_text("\n".join(lines))
    line = fails("run", scenario(train="heavy.toml"), "--out", str(tmp_path / "o"))
    assert "heavy.toml" in line
    assert "mass_t" in line
    assert "-5" in line


def test_overlapping_limits_are_refused(scenario, tmp_path):
    text = (Path(shipped.__file__).parent / "lines" / "cat_linh_la_thanh.toml").read_text()
    (tmp_path / "line.toml").write_text(
        text + "\n[[speed_limits]]\nstart_m = 200.0\nend_m = 300.0\nlimit_kmh = 30.0\n"
    )
    line = fails("run", scenario(line="line.toml"), "--out", str(tmp_path / "o"))
    assert "line.toml" in line
    assert "overlap" in line


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["run", "no_such_scenario"], "no_such_scenario"),
        (["run", "missing.toml"], "missing.toml"),
        (["run", "--law", "magic"], "magic"),
        (["run", "--set", "controller.law"], "dotted.key=value"),
        (["run", "--set", "journey.time_s=20"], "time_s"),
        (["run", "--set", "journey.from=Nowhere"], "Nowhere"),
        (["run", "--priority", "200"], "200"),
        (["run", "--no-such-option"], "no-such-option"),
        (["run", "--dbc", "missing.dbc"], "missing.dbc"),
        (["view", "nowhere"], "nowhere"),
        (["frobnicate"], "frobnicate"),
    ],
)
def test_wrong_words_are_one_line(arguments, wanted, tmp_path):
    assert wanted in fails(*arguments, cwd=tmp_path)


def test_dbc_without_a_message_is_named(tmp_path):
    import dbc

    text = dbc.path().read_text()
    kept, skipping = [], False
    for line in text.splitlines():
        if line.startswith("BO_ "):
            skipping = " ATO_Status:" in line
        if not skipping and "641" not in line:  # 0x281: comments and attributes of the same message
            kept.append(line)
    (tmp_path / "short.dbc").write_text("\n".join(kept))
    line = fails("run", "--lockstep", "--dbc", "short.dbc", cwd=tmp_path)
    assert "short.dbc" in line
    assert "ATO_Status" in line


def test_bus_that_is_not_there_is_exit_3_with_the_remedy(tmp_path):
    line = fails("run", "-i", "socketcan", "-c", "nocan9", code=3, cwd=tmp_path)
    assert "socketcan" in line.lower()
    assert "hil doctor" in line or "ip link" in line or "-i hil" in line


def test_unknown_interface_is_refused(tmp_path):
    done = hil("run", "-i", "telepathy", "-c", "x", cwd=tmp_path, timeout_s=60)
    assert done.returncode in (2, 3)
    assert "telepathy" in one_line(done.stderr)


def test_a_recording_is_never_overwritten(tmp_path):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "run.rrd").write_bytes(b"precious")
    line = fails("run", "--out", "old", cwd=tmp_path)
    assert "already holds a recording" in line
    assert (tmp_path / "old" / "run.rrd").read_bytes() == b"precious"
