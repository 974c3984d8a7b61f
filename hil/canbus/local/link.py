"""Local bus, how a client gets to its hub: connect, start one if there is none, say HELLO; ask how it is."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from hil.canbus.local import address, wire
from hil.canbus.local.address import NoHubError
from hil.canbus.local.wire import HEADER, HEADER_SIZE, Control, WireError

LINGER_S = 2.0
"""How long a hub that was started by itself stays after its last client."""

JOIN_LIMIT_S = 10.0
_ANSWER_LIMIT_S = 5.0
_RESTART_S = 0.5  # a hub that is just ending may still hold the channel: try again after this


class JoinError(RuntimeError):
    """No hub could be joined: why, and what to do, in one line."""


def join(
    channel: str, hello: dict[str, Any], *, autostart: bool, limit_s: float = JOIN_LIMIT_S
) -> tuple[socket.socket, dict[str, Any]]:
    """A connection to the hub of `channel` that has joined, and the hub's WELCOME.

    Without a hub one is started, unless `autostart` is off. Raises JoinError, `address.AddressError` when the
    channel has no possible name, WireError when the hub speaks another version.
    """
    deadline_s = time.monotonic() + limit_s
    started_s = -_RESTART_S
    while True:
        try:
            return _say_hello(channel, hello)
        except (NoHubError, ConnectionError):
            # Nobody there, or a hub that is ending.
            if not autostart:
                raise JoinError(
                    f"channel '{channel}' of the local bus has no hub; start one with "
                    f"'python -m hil.canbus.local --channel {channel}' or leave autostart on"
                ) from None
        except OSError as error:
            raise JoinError(
                f"the hub of channel '{channel}' does not answer ({error.strerror or error}); is it stopped?"
            ) from None
        now_s = time.monotonic()
        if now_s > deadline_s:
            raise JoinError(f"channel '{channel}' of the local bus: a hub was started but cannot be joined")
        if now_s - started_s >= _RESTART_S:
            start_hub(channel, bitrate=hello.get("bitrate"), data_bitrate=hello.get("data_bitrate"))
            started_s = now_s
        else:
            time.sleep(0.01)


def start_hub(
    channel: str,
    *,
    bitrate: int | None = None,
    data_bitrate: int | None = None,
    tx_queue_frames: int | None = None,
    restart_ms: int | None = None,
    linger_s: float | None = LINGER_S,
) -> None:
    """Start a hub of its own session that ends `linger_s` after its last client (None: never).

    Raises JoinError.

    Returns when it listens. That another hub has the channel meanwhile is no error.
    """
    command = [sys.executable, "-m", "hil.canbus.local", "--channel", channel]
    if linger_s is not None:
        command += ["--linger", f"{linger_s:g}"]
    if bitrate is not None:
        command += ["--bitrate", str(bitrate)]
        if data_bitrate is not None:
            command += ["--data-bitrate", str(data_bitrate)]
        if tx_queue_frames is not None:
            command += ["--tx-queue", str(tx_queue_frames)]
        if restart_ms is not None:
            command += ["--restart-ms", str(restart_ms)]
    root = Path(__file__).parents[3]  # where `hil` is importable from, whatever the caller's folder
    if hasattr(os, "fork"):
        done = subprocess.run(
            [*command, "--detach"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            cwd=root,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
            raise JoinError(f"channel '{channel}' of the local bus: no hub could be started: {lines[-1]}")
        return
    flags = getattr(subprocess, "DETACHED_PROCESS", 0) | getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)
    hub = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=root,
        creationflags=flags,
    )
    hub.returncode = 0  # it outlives this process on purpose: no warning about a child still running


def query(channel: str, timeout_s: float = 1.0) -> dict[str, Any]:
    """The statistics of the hub of `channel`, without joining.

    Raises NoHubError when there is none, OSError when it does not answer in time.
    """
    with address.connect(channel, timeout_s) as sock:
        sock.sendall(wire.control_record(Control.QUERY, {}))
        code, content = _answer(sock)
        if code != Control.STATISTICS:
            raise WireError(f"hub of channel '{channel}' answered {code} instead of statistics")
        return content


def disturb(channel: str, timeout_s: float = 1.0, **disturbance: Any) -> None:
    """Let transmissions on a channel with a bit rate meet errors; keywords: those of `Disturbance` that JSON
    can hold, or `clear=True` to end it.

    Raises NoHubError when there is no hub, WireError when it refuses, OSError when it does not answer.
    """
    with address.connect(channel, timeout_s) as sock:
        sock.sendall(wire.control_record(Control.DISTURB, disturbance))
        code, content = _answer(sock)
        if code != Control.DISTURBED:
            raise WireError(f"hub of channel '{channel}': {content.get('reason', code)}")


def _say_hello(channel: str, hello: dict[str, Any]) -> tuple[socket.socket, dict[str, Any]]:
    sock = address.connect(channel, _ANSWER_LIMIT_S)
    try:
        sock.sendall(wire.control_record(Control.HELLO, hello | {"protocol": wire.PROTOCOL_VERSION}))
        code, content = _answer(sock)
        if code == Control.ENDED and content.get("refused"):
            raise JoinError(f"channel '{channel}' of the local bus: {content.get('reason')}")
        if code == Control.ENDED and "could not read" not in str(content.get("reason")):
            raise ConnectionResetError
        if code != Control.WELCOME:
            raise WireError(f"hub of channel '{channel}': {content.get('reason', code)}")
        sock.setblocking(False)
    except BaseException:
        sock.close()
        raise
    return sock, content


def _answer(sock: socket.socket) -> tuple[int, dict[str, Any]]:
    # Exactly one record: frames that follow belong to the caller.
    header = _exactly(sock, HEADER_SIZE)
    _, code, length, _, _ = HEADER.unpack(header)
    return code, wire.control_content(_exactly(sock, length))


def _exactly(sock: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = sock.recv(size - len(data))
        if not more:
            raise ConnectionResetError
        data += more
    return data
