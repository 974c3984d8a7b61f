"""Hubs and other processes for the tests of the local bus; none outlives its test."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

LIMIT_S = 60.0


class Process:
    """A child process whose output is read at its end."""

    def __init__(self, *arguments, stdin=subprocess.DEVNULL, env=None):
        self.popen = subprocess.Popen(
            [sys.executable, *arguments],
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=env,
        )

    def wait_for_line(self, start):
        """The next line of standard output, which has to begin with `start`."""
        line = self.popen.stdout.readline()
        assert line.startswith(start), (line, self.popen.poll(), self.popen.stderr.read())
        return line.strip()

    def end(self, signal=None):
        """(exit code, standard output, standard error), after `signal` if one is given."""
        if signal is not None:
            self.popen.send_signal(signal)
        out, err = self.popen.communicate(timeout=LIMIT_S)
        return self.popen.returncode, out, err


@pytest.fixture
def spawn():
    """Start a Python process; it is killed at the end of the test if it still runs."""
    processes = []

    def start(*arguments, **options):
        process = Process(*arguments, **options)
        processes.append(process)
        return process

    yield start
    for process in processes:
        if process.popen.poll() is None:
            process.popen.kill()
        process.popen.communicate()


@pytest.fixture
def start_hub(spawn):
    """Start a hub process that listens."""

    def start(channel, *options, **more):
        hub = spawn("-m", "hil.canbus.local", "--channel", channel, *options, **more)
        hub.wait_for_line("ready")
        return hub

    return start


@pytest.fixture
def until():
    """Wait for a condition; fails when it does not come true."""

    def wait(condition, what):
        deadline_s = time.monotonic() + LIMIT_S
        while time.monotonic() < deadline_s:
            if condition():
                return
            time.sleep(0.01)
        pytest.fail(f"never came true: {what}")

    return wait


@pytest.fixture(autouse=True)
def _own_runtime_folder(tmp_path_factory, monkeypatch):
    """Sockets of the tests live in a folder of their own (short: a socket's path is limited)."""
    folder = tmp_path_factory.getbasetemp() / "run"
    folder.mkdir(mode=0o700, exist_ok=True)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))


@pytest.fixture(autouse=True)
def _no_can_configuration(monkeypatch):
    """The tests do not depend on how python-can is configured on this machine."""
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("can.util.CONFIG_FILES", [])
