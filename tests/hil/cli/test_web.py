"""The viewer in a browser: served to one, told in one line, and gone with whoever started it."""

import json
import re
import signal
import subprocess
import sys
import time
import urllib.request
from urllib.parse import parse_qs, urlsplit

import pytest

HIL = [sys.executable, "-m", "hil"]
ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+/\S+")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A short run, shown live in a browser that nobody opens."""
    out = tmp_path_factory.mktemp("web") / "run"
    done = subprocess.run(
        [*HIL, "run", "--lockstep", "--web", "--json", "-i", "virtual", "-c", "web", "--out", str(out)],
        capture_output=True,
        text=True,
        timeout=240,
        stdin=subprocess.DEVNULL,
    )
    return out, done


def test_a_run_shown_in_a_browser_is_a_run_like_any_other(run):
    out, done = run
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["verdict"] == "passed"
    assert ADDRESS.search(done.stderr)
    assert (out / "run.rrd").is_file()


@pytest.mark.parametrize(("ended_by", "code"), [(signal.SIGINT, 0), (signal.SIGKILL, -signal.SIGKILL)])
def test_view_serves_page_and_recording_until_it_ends(run, ended_by, code):
    out, _ = run
    server = subprocess.Popen([*HIL, "view", str(out), "--web"], stdout=subprocess.PIPE, text=True)
    try:
        address = ADDRESS.search(server.stdout.readline()).group()
        with urllib.request.urlopen(address, timeout=20) as page:
            assert b"rerun" in page.read().lower()
        (data,) = parse_qs(urlsplit(address).query)["url"]
        assert re.fullmatch(r"rerun\+http://127\.0\.0\.1:\d+/proxy", data)
    finally:
        server.send_signal(ended_by)
    assert server.wait(20) == code
    deadline = time.monotonic() + 10
    while True:
        try:
            urllib.request.urlopen(address, timeout=2).close()
        except OSError:
            break
        assert time.monotonic() < deadline, "the server outlives the command"
        time.sleep(0.1)
