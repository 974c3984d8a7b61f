import signal

import pytest

from hil.bench.children import Child, read_json
from hil.bench.errors import BenchError


@pytest.fixture
def child(tmp_path, monkeypatch):
    """Start a child that runs the given source; ended at the end of the test."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    started = []

    def start(source: str) -> Child:
        (tmp_path / "victim.py").write_text(source)
        started.append(Child("victim", "victim", [], logs=tmp_path / "logs"))
        return started[-1]

    yield start
    for one in started:
        one.end(timeout_s=5.0)


def test_ready_is_waited_for_and_a_clean_end_is_code_0(child):
    one = child(
        "import signal, sys\nsignal.signal(15, lambda *_: sys.exit(0))\nprint('ready')\nsignal.pause()\n"
    )
    one.wait_for_line("ready", 20.0)
    assert one.running
    assert one.end() == 0


def test_a_child_that_refuses_its_input_passes_on_its_line_and_exit_code_2(child):
    one = child("import sys\nprint('victim: my.toml: law: unknown', file=sys.stderr)\nsys.exit(2)\n")
    with pytest.raises(BenchError, match=r"^victim: my\.toml: law: unknown$") as caught:
        one.wait_for_line("ready", 20.0)
    assert caught.value.exit_code == 2


def test_a_child_that_never_gets_ready_is_named(child):
    one = child("import time\ntime.sleep(60)\n")
    with pytest.raises(BenchError, match=r"victim: not ready after 0\.2 s"):
        one.wait_for_line("ready", 0.2)


def test_a_killed_child_is_named_with_its_signal(child):
    one = child("import time\nprint('ready', flush=True)\ntime.sleep(60)\n")
    one.wait_for_line("ready", 20.0)
    one.signal(signal.SIGKILL)
    one.end()
    assert one.last_words() == "victim: killed by signal 9 (SIGKILL)"


def test_a_child_deaf_to_sigterm_is_killed_in_the_end(child):
    one = child(
        "import signal, time\nsignal.signal(15, signal.SIG_IGN)\nprint('ready', flush=True)\ntime.sleep(60)\n"
    )
    one.wait_for_line("ready", 20.0)
    assert one.end(timeout_s=0.2) == -signal.SIGKILL


def test_a_status_file_that_is_missing_or_half_written_is_empty(tmp_path):
    assert read_json(tmp_path / "none.json") == {}
    (tmp_path / "half.json").write_text('{"state": "rea')
    assert read_json(tmp_path / "half.json") == {}
    (tmp_path / "whole.json").write_text('{"state": "ready"}')
    assert read_json(tmp_path / "whole.json") == {"state": "ready"}
