"""The hub as a process: how it starts, ends, races and dies, and what its clients and its user are told."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys

import can
import pytest

from hil.canbus.local import address, link, wire
from hil.canbus.local.client import HilBus
from hil.canbus.local.hub import Hub

WAIT_S = 10.0


def message(number=0):
    return can.Message(arbitration_id=0x100, is_extended_id=False, data=number.to_bytes(4, "little"))


def hub_pid(channel):
    return link.query(channel)["pid"]


def has_hub(channel):
    try:
        link.query(channel)
    except OSError:
        return False
    return True


def files_of(channel):
    return sorted(path.name for path in address.folder().glob(f"{channel}.*"))


# -- start ------------------------------------------------------------------------------------------------


def test_bus_starts_a_hub_that_ends_after_its_last_client(channel, until):
    with can.Bus(interface="hil", channel=channel) as first:
        with can.Bus(interface="hil", channel=channel) as second:
            assert hub_pid(channel) != os.getpid()
            first.send(message(1))
            assert second.recv(WAIT_S) is not None
        assert has_hub(channel)
    until(lambda: not files_of(channel), "the hub and its files are gone")
    assert not has_hub(channel)


def test_hub_stays_for_a_client_that_comes_while_it_lingers(channel):
    HilBus(channel).shutdown()
    pid = hub_pid(channel)
    with HilBus(channel):
        assert hub_pid(channel) == pid


def test_hub_that_nobody_joined_ends_by_itself(channel, monkeypatch):
    monkeypatch.setattr("hil.canbus.local.hub.FIRST_CLIENT_S", 0.2)
    assert Hub(channel, linger_s=0.1).serve() == "nobody was left"


def test_without_autostart_a_missing_hub_is_one_clear_line(channel):
    with pytest.raises(can.CanInitializationError) as caught:
        can.Bus(interface="hil", channel=channel, autostart=False)
    assert "has no hub; start one with 'python -m hil.canbus.local --channel" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_explicit_hub_is_used_and_stays(channel, start_hub):
    hub = start_hub(channel)
    for _ in range(2):
        with can.Bus(interface="hil", channel=channel, autostart=False):
            assert hub_pid(channel) == hub.popen.pid
    assert hub.popen.poll() is None


def test_of_two_hubs_one_wins_and_the_other_says_so(channel, start_hub, spawn):
    first = start_hub(channel)
    code, out, err = spawn("-m", "hil.canbus.local", "--channel", channel).end()
    assert (code, out) == (0, "")
    assert err == f"channel '{channel}' has a hub already (process {first.popen.pid}); nothing to do\n"
    assert hub_pid(channel) == first.popen.pid


def test_of_many_hubs_started_at_once_exactly_one_serves(channel, spawn, until):
    hubs = [spawn("-m", "hil.canbus.local", "--channel", channel) for _ in range(6)]
    until(lambda: sum(hub.popen.poll() is None for hub in hubs) == 1, "five of six hubs have ended")
    until(lambda: has_hub(channel), "the sixth one serves")
    (winner,) = [hub for hub in hubs if hub.popen.poll() is None]
    assert hub_pid(channel) == winner.popen.pid
    assert all(hub.end()[0] == 0 for hub in hubs if hub is not winner)


def test_clients_that_start_at_once_meet_on_one_hub(channel, spawn):
    script = (
        "import can, sys\n"
        "bus = can.Bus(interface='hil', channel=sys.argv[1])\n"
        "print('pid', bus.statistics()['pid'], flush=True)\n"
        "sys.stdin.read()\n"
        "bus.shutdown()\n"
    )
    clients = [spawn("-c", script, channel, stdin=subprocess.PIPE) for _ in range(5)]
    assert len({client.wait_for_line("pid") for client in clients}) == 1
    assert len(link.query(channel)["clients"]) == 5
    assert all(client.end()[::2] == (0, "") for client in clients)


def test_stale_socket_of_a_dead_hub_is_replaced(channel, start_hub):
    dead = start_hub(channel)
    dead.end(signal.SIGKILL)
    assert f"{channel}.sock" in files_of(channel)
    with HilBus(channel) as first, HilBus(channel) as second:
        first.send(message(5))
        assert second.recv(WAIT_S) is not None
        assert hub_pid(channel) != dead.popen.pid


def test_file_in_the_place_of_the_socket_is_replaced(channel, start_hub):
    address.socket_path(channel).write_text("not a socket")
    start_hub(channel)
    with HilBus(channel, autostart=False):
        pass


# -- end --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_ends_the_hub_in_order_and_every_client_is_told(channel, start_hub, number):
    hub = start_hub(channel)
    with HilBus(channel) as reader, HilBus(channel) as sender, HilBus(channel) as third:
        sender.send(message(1))
        code, _, err = hub.end(number)
        assert (code, err) == (0, "")
        assert files_of(channel) == []
        assert reader.recv(WAIT_S) is not None  # what was sent before the end arrives
        assert len(third.drain_raw()) == 1
        said = f"the hub of channel '{channel}' has ended ({number.name})"
        for call in (
            lambda: reader.recv(None),
            lambda: sender.send(message(2)),
            lambda: sender.recv(None),
            third.drain_raw,
            lambda: third.recv_raw(None),
        ):
            with pytest.raises(can.CanOperationError) as caught:
                call()
            assert str(caught.value) == said


def test_killed_hub_is_reported_to_every_client(channel, start_hub):
    hub = start_hub(channel)
    with HilBus(channel) as reader, HilBus(channel) as sender:
        hub.end(signal.SIGKILL)
        with pytest.raises(can.CanOperationError, match="has ended without a goodbye; was it killed"):
            reader.recv(None)
        with pytest.raises(can.CanOperationError, match="has ended without a goodbye; was it killed"):
            sender.send(message())


def test_waiting_client_is_woken_by_the_end_of_the_hub(channel, start_hub, spawn):
    hub = start_hub(channel)
    script = (
        "import can, sys\n"
        "bus = can.Bus(interface='hil', channel=sys.argv[1])\n"
        "print('waits', flush=True)\n"
        "try:\n"
        "    bus.recv(None)\n"
        "except can.CanOperationError as error:\n"
        "    print(error)\n"
        "bus.shutdown()\n"
    )
    client = spawn("-c", script, channel)
    client.wait_for_line("waits")
    hub.end(signal.SIGTERM)
    assert client.end() == (0, f"the hub of channel '{channel}' has ended (SIGTERM)\n", "")


def test_asyncio_notifier_gets_the_end_of_the_hub_once(channel, start_hub):
    hub = start_hub(channel)
    errors = []

    async def watch(bus):
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: errors.append(str(context["exception"])))
        notifier = can.Notifier(bus, [lambda received: None], loop=loop)
        hub.end(signal.SIGTERM)
        while not errors:
            await asyncio.sleep(0.01)
        for _ in range(50):
            await asyncio.sleep(0)
        notifier.stop()

    with HilBus(channel) as bus:
        asyncio.run(watch(bus))
        assert errors == [f"the hub of channel '{channel}' has ended (SIGTERM)"]
        with pytest.raises(can.CanOperationError):
            bus.recv(0)


def test_asyncio_notifier_rests_after_the_sender_met_the_end_first(channel, start_hub):
    hub = start_hub(channel)
    errors = []

    async def watch(bus, received):
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: errors.append(str(context["exception"])))
        with HilBus(channel) as other:
            other.send(message(1))
        hub.end(signal.SIGTERM)
        with pytest.raises(can.CanOperationError):
            bus.send(message(2))
        notifier = can.Notifier(bus, [received.append], loop=loop)
        while not errors:
            await asyncio.sleep(0.01)
        for _ in range(50):
            await asyncio.sleep(0)
        notifier.stop()

    with HilBus(channel) as bus:
        received = []
        asyncio.run(watch(bus, received))
    assert len(received) == 1
    assert errors == [f"the hub of channel '{channel}' has ended (SIGTERM)"]


def test_what_waits_when_the_hub_is_asked_to_end_is_still_delivered(channel):
    hub = Hub(channel)
    hello = {"protocol": wire.PROTOCOL_VERSION, "name": "raw", "pid": 1}
    frame = wire.HEADER.pack(0, 0x123, 3, 0, 3) + b"abc"
    with address.connect(channel, 1.0) as receiver, address.connect(channel, 1.0) as sender:
        receiver.sendall(wire.control_record(wire.Control.HELLO, hello))
        sender.sendall(wire.control_record(wire.Control.HELLO, hello) + frame * 3)
        hub.stop("asked to")
        assert hub.serve() == "asked to"
        received = b"".join(iter(lambda: receiver.recv(4096), b""))
    assert received.count(b"abc") == 3
    assert b'"reason":"asked to"' in received


def test_hub_ends_with_its_parent(channel, start_hub):
    hub = start_hub(channel, "--parent-pipe", stdin=subprocess.PIPE)
    with HilBus(channel) as bus:
        hub.popen.stdin.close()
        hub.popen.stdin = None
        assert hub.end()[::2] == (0, "")
        with pytest.raises(can.CanOperationError, match="the process that started it is gone"):
            bus.recv(None)


def test_parent_pipe_needs_a_pipe(channel, spawn):
    hub = spawn("-m", "hil.canbus.local", "--channel", channel, "--parent-pipe")
    assert hub.end() == (2, "", "--parent-pipe: standard input is not a pipe\n")
    assert files_of(channel) == []


def test_client_can_join_a_new_hub_after_the_old_one_ended(channel, start_hub):
    hub = start_hub(channel)
    with HilBus(channel) as old:
        hub.end(signal.SIGTERM)
        with HilBus(channel) as new, HilBus(channel) as other:
            new.send(message(3))
            assert other.recv(WAIT_S) is not None
        with pytest.raises(can.CanOperationError, match="has ended"):
            old.recv(0)


# -- clients that die or misbehave --------------------------------------------------------------------------


def test_killed_client_is_removed_with_one_line_and_others_go_on(channel, start_hub, spawn, until):
    hub = start_hub(channel)
    script = (
        "import can, sys\n"
        "bus = can.Bus(interface='hil', channel=sys.argv[1], name='victim')\n"
        "print('joined', flush=True)\n"
        "bus.recv(None)\n"
    )
    victim = spawn("-c", script, channel)
    victim.wait_for_line("joined")
    with HilBus(channel) as first, HilBus(channel) as second:
        victim.end(signal.SIGKILL)
        until(lambda: len(link.query(channel)["clients"]) == 2, "the hub has removed the killed client")
        first.send(message(4))
        assert second.recv(WAIT_S) is not None
    _, _, err = hub.end(signal.SIGTERM)
    pid = victim.popen.pid
    assert (
        err
        == f"hub of channel '{channel}': client 'victim' (process {pid}) is gone without a goodbye; 2 left\n"
    )


def test_frames_of_a_client_that_leaves_at_once_arrive(channel):
    with HilBus(channel) as receiver:
        for leaver in range(20):
            with HilBus(channel) as sender:
                for n in range(50):
                    sender.send(message(leaver * 50 + n))
        received = []
        while len(received) < 1000:
            frame = receiver.recv_raw(WAIT_S)
            assert frame is not None
            received.append(int.from_bytes(frame.data, "little"))
    assert received == list(range(1000))


def test_client_that_speaks_nonsense_is_removed_and_others_go_on(channel, start_hub, until):
    hub = start_hub(channel)
    with HilBus(channel) as first, HilBus(channel) as second:
        for nonsense in (b"GET / HTTP/1.1\r\n\r\n" * 20, wire.control_record(wire.Control.GOODBYE, {}) * 2):
            with address.connect(channel, 1.0) as sock:
                sock.sendall(nonsense)
        with address.connect(channel, 1.0) as sock:
            sock.sendall(wire.control_record(wire.Control.HELLO, {"protocol": 99}))
            answer = sock.recv(1000)
        assert b"it speaks protocol 99" in answer
        first.send(message(6))
        assert second.recv(WAIT_S) is not None
    code, _, err = hub.end(signal.SIGTERM)
    assert code == 0
    assert "Traceback" not in err
    assert "client without a name was removed: it speaks protocol 99" in err


def test_record_in_pieces_is_put_together(channel, start_hub):
    start_hub(channel)
    hello = wire.control_record(
        wire.Control.HELLO, {"protocol": wire.PROTOCOL_VERSION, "name": "slow", "pid": 1}
    )
    frame = wire.HEADER.pack(0, 0x123, 3, 0, 3) + b"abc"
    with HilBus(channel) as receiver, address.connect(channel, 1.0) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        for byte in hello + frame * 3:
            sock.send(bytes([byte]))
        assert [receiver.recv_raw(WAIT_S)[1:] for _ in range(3)] == [(0x123, b"abc")] * 3


# -- options ----------------------------------------------------------------------------------------------


def test_refused_priority_is_one_line_and_not_fatal(channel, spawn):
    script = (
        "import os, sys\n"
        "def refuse(*_): raise PermissionError(1, 'Operation not permitted')\n"
        "os.sched_setscheduler = refuse\n"
        "from hil.canbus.local.__main__ import main\n"
        "sys.exit(main(['--channel', sys.argv[1], '--priority', '40']))\n"
    )
    hub = spawn("-c", script, channel)
    hub.wait_for_line("ready")
    with HilBus(channel, autostart=False):
        pass
    code, _, err = hub.end(signal.SIGTERM)
    assert code == 0
    assert err.startswith("--priority 40: SCHED_FIFO refused (Operation not permitted); going on without.")
    assert err.count("\n") == 1


def test_statistics_tell_frames_and_clients(channel):
    with HilBus(channel, name="a") as first, HilBus(channel, name="b") as second:
        for n in range(3):
            first.send(message(n))
        while len(second.drain_raw()) == 0:
            pass
        statistics = first.statistics()
    assert statistics["channel"] == channel
    assert statistics["frames"] == 3
    assert [(client["name"], client["frames_sent"]) for client in statistics["clients"]] == [
        ("a", 3),
        ("b", 0),
    ]
    assert statistics["backlog_bytes"] == 0


def test_running_channels_are_detected_and_dead_ones_are_not(channel, start_hub):
    hub = start_hub(channel)
    assert {"interface": "hil", "channel": channel} in can.detect_available_configs("hil")
    hub.end(signal.SIGKILL)
    assert f"{channel}.sock" in files_of(channel)
    assert {"interface": "hil", "channel": channel} not in can.detect_available_configs("hil")


def test_hub_imports_neither_python_can_nor_numpy():
    script = "import sys, hil.canbus.local.__main__; print([m for m in ('can', 'numpy') if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", script], text=True) == "[]\n"
