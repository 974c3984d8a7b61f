"""`hil bus` as a user types it: analysis, load, dump and the local bus's hub."""

import json
import os
import signal
import subprocess
import sys
import time

import can
import pytest

from hil.canbus.local import link
from hil.cli import main

PNG = b"\x89PNG\r\n"


def hil(*arguments, cwd=None, stdin=None):
    return subprocess.run(
        [sys.executable, "-m", "hil", "bus", *arguments],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=cwd,
        stdin=stdin,
        env={**os.environ, "COLUMNS": "130"},
    )


def one_line(done, code=2):
    assert done.returncode == code, (done.stdout, done.stderr)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert done.stdout == ""
    return lines[0]


@pytest.fixture
def log(tmp_path):
    """A run's frames: two messages of the contract and one that it does not know, 10 ms apart."""
    run = tmp_path / "run"
    run.mkdir()
    with can.Logger(run / "frames.blf") as writer:
        for number in range(300):
            can_id, data = [(0x184, bytes(8)), (0x701, b"\x05"), (0x123, b"")][number % 3]
            writer(
                can.Message(
                    timestamp=1e9 + number * 0.01, arbitration_id=can_id, is_extended_id=False, data=data
                )
            )
    return run


# -- analyse -----------------------------------------------------------------------------------------------


def test_the_bench_meets_its_deadlines_at_500_kbit(tmp_path):
    done = hil("analyse", "--bitrate", "500000", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "no message can miss its deadline" in done.stdout
    assert "ODO_Balise: event, at most one in 10 ms (the shortest cycle of ODO)" in done.stdout
    assert "queues: first in, first out, one each for ATO, TCU+BCU+ODO+ATP, BENCH" in done.stdout
    assert "left out: SYNC, sent in lockstep only" in done.stdout
    assert (tmp_path / "bus-analysis.png").read_bytes().startswith(PNG)


def test_a_bus_that_is_too_slow_is_exit_code_1_and_says_which_message_and_which_rate():
    done = hil("analyse", "-b", "125000", "--queue", "priority", "--json")
    assert done.returncode == 1
    found = json.loads(done.stdout)
    assert [m["name"] for m in found["messages"] if not m["meets"]] == ["ODO_Balise"]
    assert found["needs_bitrate"] == 250_000
    assert 125_000 < found["threshold_bitrate"] < 250_000
    assert found["left_out"].keys() == {"SYNC", "ATO_SyncDone", "TCU_SyncDone"}


def document(capsys, *arguments):
    """The same in this process: most of the time of a command is imports."""
    main(["bus", "analyse", "--json", *arguments])
    return json.loads(capsys.readouterr().out)


def refused(capsys, *arguments):
    """The one line of a command that ends with exit code 2, in this process."""
    assert main(["bus", *arguments]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert len(told.err.splitlines()) == 1
    return told.err


def test_the_queue_decides_on_deadlines(capsys):
    fifo, together, mailboxes = (
        document(capsys, "-b", "250000", *options)
        for options in (["--together", "none"], [], ["--queue", "priority"])
    )
    late = [[m["name"] for m in found["messages"] if not m["meets"]] for found in (fifo, together, mailboxes)]
    assert late == [["ATO_Emergency", "ATO_Command"], ["ATO_Emergency", "ATO_Command"], []]
    assert [found["queue"] for found in (fifo, together, mailboxes)] == ["auto", "auto", "priority"]
    assert together["together"] == [["TCU", "BCU", "ODO", "ATP"]]
    assert "FIFO queues" in together["method"]
    assert "revisited" in mailboxes["method"]
    main(["bus", "analyse", "--queue", "priority"])
    assert "mailbox per message" in capsys.readouterr().out


def test_options_change_what_is_analysed(capsys):
    plain = document(capsys)
    for options in (
        ["--jitter", "2"],
        ["--cycle", "ATO_Command=1"],
        ["--error-interval", "5"],
        ["--event-interval", "1.5"],
    ):
        changed = document(capsys, *options)
        assert changed["threshold_bitrate"] > plain["threshold_bitrate"], options


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--bitrate", "0"], "--bitrate 0: must be 1 to 1000000 bit/s"),
        (["--data-bitrate", "1000"], "--data-bitrate 1000: must be from the nominal bit rate"),
        (["--jitter", "-1"], "--jitter -1: must be 0 to"),
        (["--jitter", "nan"], "--jitter nan: must be 0 to"),
        (["--cycle", "ATO_Command"], "write it as MESSAGE=MS"),
        (["--cycle", "Ato=1"], "no message 'Ato'"),
        (["--cycle", "ATO_Command=0"], "--cycle ATO_Command 0: must be above 0"),
        (["--error-burst", "2"], "needs --error-interval"),
        (["--together", "TCU,Bcu"], "--together Bcu: no such sender in ato_bench.dbc; it has ATO, "),
        (["--together", "TCU,BCU", "--together", "BCU,ODO"], "--together BCU: named twice"),
        (["--queue", "priority", "--together", "TCU,BCU"], "no node has a queue to share"),
        (["--dbc", "missing.dbc"], "missing.dbc: no such DBC file"),
    ],
)
def test_bad_input_is_one_line_that_says_what_would_be_right(arguments, text, capsys):
    assert text in refused(capsys, "analyse", *arguments)


# -- load and dump -----------------------------------------------------------------------------------------


def test_the_load_of_a_run_is_counted_from_its_frames(log, capsys):
    done = hil("load", str(log), "-b", "125000", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["frames"], found["bitrate"]) == (300, 125_000)
    assert [row["name"] for row in found["messages"]] == ["ODO_Motion", "ATO_Heartbeat", None]
    assert found["load"] + found["idle"] == pytest.approx(1.0)
    assert found["load"] == pytest.approx(sum(row["load"] for row in found["messages"]))
    assert found["load"] == pytest.approx(found["bits_per_s"] / 125_000)
    main(["bus", "load", str(log)])
    shown = capsys.readouterr().out
    assert "not in the DBC" in shown
    assert "largest in 10 ms" in shown


def test_a_log_that_is_missing_or_empty_or_no_log_is_one_line(tmp_path, capsys):
    assert "no such log" in refused(capsys, "load", str(tmp_path))
    (tmp_path / "x.blf").write_bytes(b"not a log")
    assert "cannot be read as a CAN log" in refused(capsys, "load", str(tmp_path / "x.blf"))
    with can.Logger(tmp_path / "frames.blf"):
        pass
    assert "holds no frames" in refused(capsys, "load", str(tmp_path))


def test_dump_decodes_by_the_dbc_and_filters_by_name(log, capsys):
    lines = hil("dump", "--log", str(log), "ODO_Motion", "-n", "3").stdout.splitlines()
    assert len(lines) == 3
    assert all("0x184  ODO_Motion" in line and "Speed=0 km/h" in line for line in lines)
    assert "no message 'Odo'" in refused(capsys, "dump", "--log", str(log), "Odo")


def test_dump_as_json_is_a_document_per_line_with_the_signals(log, capsys):
    lines = hil("dump", "--log", str(log), "--json").stdout.splitlines()
    found = [json.loads(line) for line in lines]
    assert len(found) == 300
    motion = next(frame for frame in found if frame["name"] == "ODO_Motion")
    assert motion["id"] == 0x184
    assert motion["kind"] == "data"
    assert motion["signals"]["Speed"] == 0
    stranger = next(frame for frame in found if frame["name"] is None)
    assert stranger["signals"] is None
    with can.LogReader(log / "frames.blf") as frames:
        assert [bytes.fromhex(frame["data"]) for frame in found] == [bytes(one.data) for one in frames]
    assert "--raw --json: one or the other" in refused(capsys, "dump", "--log", str(log), "--raw", "--json")


def test_raw_dump_is_read_back_by_python_can(log, tmp_path):
    (tmp_path / "x.log").write_text(hil("dump", "--log", str(log), "--raw").stdout)
    with can.LogReader(tmp_path / "x.log") as back, can.LogReader(log / "frames.blf") as frames:
        for one, other in zip(back, frames, strict=True):
            assert (one.arbitration_id, one.data) == (other.arbitration_id, other.data)
            assert one.timestamp == pytest.approx(other.timestamp, abs=1e-6)


# -- the local bus -----------------------------------------------------------------------------------------


@pytest.fixture
def up(channel):
    done = hil("up", "-c", channel, "--json")
    assert done.returncode == 0, done.stderr
    yield json.loads(done.stdout)
    hil("down", "-c", channel)


def told(capsys, *arguments):
    """The JSON document of a command of `hil bus`, in this process."""
    assert main(["bus", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_hub_goes_up_once_and_down(channel, capsys):
    assert json.loads(hil("up", "-c", channel, "--json").stdout)["started"]
    assert not told(capsys, "up", "-c", channel)["started"]
    assert "has a hub already" in refused(capsys, "up", "-c", channel, "-b", "125000")
    assert [hub["channel"] for hub in told(capsys, "statistics", "-c", channel)] == [channel]
    assert told(capsys, "down", "-c", channel)["stopped"]
    assert "has no hub" in one_line(hil("statistics", "-c", channel), 3)


def test_a_hub_has_the_wire_that_it_was_asked_for(channel, capsys):
    wire = ["-b", "500000", "--data-bitrate", "2000000"]
    told(capsys, "up", "-c", channel, *wire, "--tx-queue", "3", "--restart-ms", "0")
    try:
        hub = link.query(channel)
        assert (hub["bitrate"], hub["data_bitrate"]) == (500_000, 2_000_000)
        with can.Bus(interface="hil", channel=channel) as bus:
            for number in range(3):  # nobody acknowledges them
                bus.send(can.Message(arbitration_id=number, is_extended_id=False), timeout=0)
            with pytest.raises(can.CanError):
                bus.send(can.Message(arbitration_id=9, is_extended_id=False), timeout=0)
        assert not told(capsys, "up", "-c", channel, *wire)["started"]
        assert "data bit rate 2000000" in refused(
            capsys, "up", "-c", channel, "-b", "500000", "--data-bitrate", "4000000"
        )
        assert "--tx-queue is for one that starts" in refused(
            capsys, "up", "-c", channel, *wire, "--tx-queue", "3"
        )
    finally:
        told(capsys, "down", "-c", channel)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--tx-queue", "3"], "--tx-queue: needs --bitrate"),
        (["-b", "500000", "--tx-queue", "0"], "--tx-queue 0: must be 1 or more"),
        (["-b", "500000", "--restart-ms", "-1"], "--restart-ms -1: must be 0 or more"),
    ],
)
def test_a_hub_with_a_wire_that_cannot_be_is_one_line(options, text, capsys):
    assert text in refused(capsys, "up", "-c", "never", *options)


def test_a_channel_that_cannot_be_is_one_line(capsys):
    assert "channel 'a/b'" in refused(capsys, "up", "-c", "a/b")


def test_a_live_bus_is_dumped_and_counted_as_it_was_sent(channel, up):
    command = [sys.executable, "-m", "hil", "bus"]
    place = ["-i", "hil", "-c", channel]
    dump = subprocess.Popen([*command, "dump", *place, "-n", "5"], stdout=subprocess.PIPE, text=True)
    load = subprocess.Popen(
        [*command, "load", *place, "--seconds", "60", "--json"], stdout=subprocess.PIPE, text=True
    )
    with can.Bus(interface="hil", channel=channel) as bus:
        wait_until(lambda: len(link.query(channel)["clients"]) == 3)
        for number in range(5):
            bus.send(can.Message(arbitration_id=0x701, is_extended_id=False, data=[number]))
        lines = dump.communicate(timeout=60)[0].splitlines()
        time.sleep(1.0)
        load.send_signal(signal.SIGINT)  # counts up to here
        found = json.loads(load.communicate(timeout=60)[0])
    assert dump.returncode == load.returncode == 0
    assert len(lines) == 5
    assert all("ATO_Heartbeat" in line for line in lines)
    assert (found["frames"], found["messages"][0]["name"]) == (5, "ATO_Heartbeat")
    assert 0.9 < found["seconds"] < 60.0


def wait_until(there):
    deadline_s = time.monotonic() + 60
    while not there():
        assert time.monotonic() < deadline_s, "the clients did not join"
        time.sleep(0.05)


def test_help_names_every_command(capsys):
    main(["bus", "--help"])
    shown = capsys.readouterr().out
    assert all(name in shown for name in ("analyse", "load", "dump", "up", "down", "statistics"))
