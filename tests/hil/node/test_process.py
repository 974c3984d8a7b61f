"""A node process: its status file, its end, its errors; always one line and never a traceback."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest

from hil.canbus.contract import Contract
from hil.canbus.transport import BusOptions
from hil.node import DeadlinesMissed, NodeOptions, NodeProcess, TimingReader

# A node on python-can's in-process bus; what a listener on that bus saw is printed when the node has ended.
SCRIPT = """
import json, os, sys
import can
from hil.node import Probe, main

class Unit:
    name, nodes, receives = "probe", ("ATO",), ("ODO_Motion",)
    period_ns, probes, after = 5_000_000, (Probe("steps", "1"),), ()
    steps = 0
    def step(self, now_ns, inbox, outbox):
        self.steps += 1
        if self.steps == 3 and "fail" in os.environ.get("PROBE", ""):
            raise RuntimeError("the unit\\nfell over")
        outbox.put("ATO_Command", {"EffortDemand": 0.5})
    def probe(self):
        return (self.steps,)
    def stop(self, outbox):
        outbox.put("ATO_Command", {"EffortDemand": -1.0, "EmergencyBrake": 1})
    def warm_up(self):
        pass

def unit_from(scenario, contract):
    if not scenario.exists():
        error = FileNotFoundError(f"{scenario}: no such scenario")
        error.exit_code = 2
        raise error
    return Unit()

with can.Bus(interface="virtual", channel="probe") as listener:
    code = main(unit_from=unit_from)
    while (message := listener.recv(0)) is not None:
        print(json.dumps([message.arbitration_id, list(message.data)]))
sys.exit(code)
"""


@pytest.fixture
def start(tmp_path):
    """Starts the node; arguments replace the defaults. All processes are ended with the test."""
    script = tmp_path / "probe.py"
    script.write_text(textwrap.dedent(SCRIPT))
    (tmp_path / "scenario.toml").write_text("")
    started = []

    def run(*arguments, bus=("-i", "virtual", "-c", "probe"), **environment):
        process = subprocess.Popen(
            [sys.executable, str(script), "--scenario", str(tmp_path / "scenario.toml"),
             "--status", str(tmp_path / "status.json"), "--priority", "0", *bus, *arguments],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, **environment},
        )  # fmt: skip
        started.append(process)
        return process

    yield run
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def status(tmp_path):
    def read(state=None, patience_s=60.0):
        path = tmp_path / "status.json"
        end = time.monotonic() + patience_s
        while True:
            with contextlib.suppress(FileNotFoundError):
                document = json.loads(path.read_text())
                if state in (None, document["state"]):
                    return document
            assert time.monotonic() < end, f"no status {state!r} within {patience_s} s"
            time.sleep(0.02)

    return read


def frames_seen(stdout):
    return [(can_id, bytes(data)) for can_id, data in map(json.loads, stdout.splitlines())]


def one_line(stderr):
    assert stderr.endswith("\n")
    assert stderr.count("\n") == 1, stderr
    assert "Traceback" not in stderr
    return stderr.strip()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_ends_the_node_with_safe_outputs_as_last_frames(start, status, contract, tmp_path, number):
    node = start("--ring", str(tmp_path / "ring"))
    ready = status("ready")
    assert (ready["unit"], ready["pid"], ready["cycles"]) == ("probe", node.pid, 0)
    reader = TimingReader.open(tmp_path / "ring")
    while reader.written < 5:
        time.sleep(0.01)
    node.send_signal(number)
    stdout, stderr = node.communicate(timeout=60)
    assert (node.returncode, stderr) == (0, "")
    frames = frames_seen(stdout)
    command = contract.message("ATO_Command")
    assert frames[-1][0] == command.can_id
    last = command.decode(frames[-1][1])
    assert (last["EffortDemand"], last["EmergencyBrake"]) == (pytest.approx(-1.0), 1)
    ended = status("ended")
    assert (ended["exit_reason"], ended["exit_code"]) == (number.name, 0)
    assert ended["cycles"] == reader.written >= 5
    assert ended["frames"]["sent"] == len(frames)
    assert ended["e2e"]["ODO_Motion"] == {"ok": 0, "rejected": 0, "lost": 0, "timeouts": 1} or (
        ended["cycles"] < 15  # ended before the message's silence limit
    )
    assert ended["rights"]["garbage_collector"]["state"] == "granted"
    assert ended["spin"]["mode"] in ("auto", "off")
    assert 0 <= ended["spin"]["cpu_share"] <= 0.25
    assert set(ended["execution_us"]) == {"wakeup_latency", "read", "step", "encode", "send", "execution"}
    assert {"missed", "max_consecutive_misses", "period_ns"} <= set(ended)


def test_unexpected_error_is_one_line_with_a_hint_and_safe_outputs(start, status, contract):
    node = start(PROBE="fail")
    stdout, stderr = node.communicate(timeout=60)
    assert node.returncode == 3
    line = one_line(stderr)
    assert line.startswith("probe: unexpected RuntimeError: the unit fell over")
    assert "HIL_TRACEBACK=1" in line
    can_id, data = frames_seen(stdout)[-1]
    assert contract.by_id[can_id].decode(data)["EmergencyBrake"] == 1
    assert status("ended")["exit_code"] == 3


def test_traceback_is_there_for_who_asks(start):
    _, stderr = start(PROBE="fail", HIL_TRACEBACK="1").communicate(timeout=60)
    assert "Traceback" in stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--clock", "sundial"], "sundial"),
        (["--priority", "100"], "100 must be 0 to 99"),
        (["--cpu", "first"], "'first' is no integer"),
        (["--peer-timeout", "-1"], "greater than 0"),
        (["--spin-us", "some"], "'some' is no integer"),
        (["--spin-us", "-1"], "-1 must be 0 or more"),
        (["--overload-grace", "-1"], "0 or greater"),
        (["--max-misses", "few"], "'few' is no integer"),
        (["--no-such-option"], "--no-such-option"),
        (["--scenario", "no_such.toml"], "no_such.toml"),
        (["--dbc", "no_such.dbc"], "no_such.dbc"),
        (["--clock", "lockstep", "--tick-ns", "3000000"], "whole multiple"),
        (["--status", "no_such_directory/status.json"], "status"),
    ],
)
def test_bad_option_is_exit_2_and_one_line(start, arguments, words):
    node = start(*arguments)
    _, stderr = node.communicate(timeout=60)
    line = one_line(stderr)
    assert node.returncode == 2, line
    assert words in line
    assert line.startswith("probe: ")


NO_HUB = ("-i", "hil", "-c", "no-such-channel", "--bus-kwargs", "autostart=False")


@pytest.mark.parametrize("bus", [NO_HUB, ("-i", "socketcan", "-c", "nocan7")])
def test_missing_bus_is_exit_3_and_one_line(start, bus):
    node = start(bus=bus)
    _, stderr = node.communicate(timeout=60)
    line = one_line(stderr)
    assert node.returncode == 3, line
    assert bus[3] in line


@pytest.mark.parametrize("clock", ["realtime", "lockstep"])
def test_lost_hub_is_exit_3_and_one_line(start, status, clock):
    channel = f"node-test-{os.getpid()}-{clock}"
    hub = subprocess.Popen(
        [sys.executable, "-m", "hil.canbus.local", "--channel", channel, "--parent-pipe"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    with hub:
        assert "ready" in hub.stdout.readline()
        node = start("--clock", clock, bus=("-i", "hil", "-c", channel, "--bus-kwargs", "autostart=False"))
        status("ready")
        hub.kill()
        _, stderr = node.communicate(timeout=60)
    assert node.returncode == 3
    assert channel in one_line(stderr)
    assert status("ended")["exit_reason"] in stderr


def test_silent_bench_is_exit_3_and_says_what_is_awaited(start, status):
    node = start("--clock", "lockstep", "--peer-timeout", "0.3")
    _, stderr = node.communicate(timeout=60)
    assert node.returncode == 3
    assert "the first SYNC did not come within 0.3 s" in one_line(stderr)
    ended = status("ended")
    assert ended["exit_code"] == 3
    assert ended["sched_fifo"] is False


def test_lockstep_node_ends_on_signal_while_it_waits(start, status):
    node = start("--clock", "lockstep")
    status("ready")
    node.send_signal(signal.SIGTERM)
    _, stderr = node.communicate(timeout=60)
    assert (node.returncode, stderr) == (0, "")


def test_signal_before_the_loop_still_sends_safe_outputs(contract, fakes, tmp_path):
    """SIGTERM during warm-up only sets the flag; the loop then does not start, the outputs are safe."""
    options = NodeOptions(scenario=tmp_path, bus=BusOptions("virtual", "early"), priority=0)
    unit = fakes.Unit()
    with NodeProcess(options, lambda *_: unit, real_time=False) as process:
        process.ready()
        process.run(lambda: True)
        assert unit.steps == []
        assert process.transport.sent == 2  # the heartbeat STOPPED and the safe command


def test_node_runs_in_a_thread_without_touching_signals_or_rights(fakes, tmp_path):
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    options = NodeOptions(scenario=tmp_path, bus=BusOptions("virtual", "thread"))
    unit = fakes.Unit(period_ns=2_000_000)
    done = threading.Event()

    def work():
        with NodeProcess(options, lambda *_: unit, real_time=False) as process:
            process.ready()
            process.run(lambda: len(unit.steps) >= 5)
            assert {right.state for right in process.rights} == {"not asked for"}
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(60)
    assert done.is_set()
    assert {number: signal.getsignal(number) for number in before} == before


def test_node_dies_with_its_parent(start, status, tmp_path):
    """A launcher that is killed leaves no orphan: the kernel asks the node to end, and it ends safely."""
    launcher = textwrap.dedent(
        """
        import subprocess, sys, time
        node = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        print(node.pid, flush=True)
        time.sleep(600)
        """
    )
    command = [
        sys.executable, str(tmp_path / "probe.py"), "--scenario", str(tmp_path / "scenario.toml"),
        "--status", str(tmp_path / "status.json"), "--priority", "0", "--die-with-parent",
        "-i", "virtual", "-c", "orphan",
    ]  # fmt: skip
    with subprocess.Popen(
        [sys.executable, "-c", launcher, *command], stdout=subprocess.PIPE, text=True
    ) as parent:
        pid = int(parent.stdout.readline())
        try:
            status("ready")
            parent.kill()
            ended = status("ended")
        except BaseException:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            raise
        finally:
            parent.kill()
    assert (ended["exit_reason"], ended["exit_code"], ended["pid"]) == ("SIGTERM", 0, pid)


def test_status_file_is_replaced_as_a_whole(contract, fakes, tmp_path):
    options = NodeOptions(
        scenario=tmp_path, bus=BusOptions("virtual", "status"), status=tmp_path / "status.json", priority=0
    )
    with NodeProcess(options, lambda *_: fakes.Unit(), real_time=False) as process:
        process.ready()
        process.write_status("ended", exit_reason="test", exit_code=0)
    assert json.loads((tmp_path / "status.json").read_text())["state"] == "ended"
    assert [path.name for path in tmp_path.iterdir()] == ["status.json"]


@pytest.mark.parametrize(
    ("arguments", "mode", "margin_ns"), [({"spin_ns": 0}, "off", 0), ({"spin_ns": 120_000}, "fixed", 120_000)]
)
def test_spin_asked_for_is_the_one_that_is_reported(fakes, tmp_path, arguments, mode, margin_ns):
    options = NodeOptions(scenario=tmp_path, bus=BusOptions("virtual", "spin"), priority=0, **arguments)
    with NodeProcess(options, lambda *_: fakes.Unit(), real_time=False) as process:
        spin = process.node.report()["spin"]
    assert (spin["mode"], spin["margin_ns"]) == (mode, margin_ns)


def test_overload_limits_of_the_command_line_halt_the_node(fakes, tmp_path):
    """Every cycle takes three periods; the node ends with safe outputs, as asked."""
    unit = fakes.Unit(period_ns=2_000_000)
    unit.on_step = lambda: time.sleep(0.006)
    options = NodeOptions(
        scenario=tmp_path,
        bus=BusOptions("virtual", "overload"),
        priority=0,
        overload_grace_s=0.0,
        max_misses=8,
    )
    with NodeProcess(options, lambda *_: unit, real_time=False) as process:
        with pytest.raises(DeadlinesMissed, match="in all"):
            process.run(lambda: len(unit.steps) > 1000)
        assert 1 < len(unit.steps) <= 9
        assert process.node.statistics.missed > 8


def test_missing_contract_message_leaves_no_open_bus(fakes, tmp_path):
    assert "No_Such" not in Contract.load().messages
    options = NodeOptions(scenario=tmp_path, bus=BusOptions("virtual", "leak"))
    with pytest.raises(ValueError, match="No_Such"):
        NodeProcess(options, lambda *_: fakes.Unit(receives=("No_Such",)), real_time=False)
