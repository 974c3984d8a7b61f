"""The Rerun viewer in a browser: a server on this machine for recordings, or for a run that sends to it."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self
from urllib.parse import quote

from hil.node.realtime import die_with_parent
from hil.record.errors import ViewerUnavailable
from hil.record.viewer import VIEWER_MEMORY, free_port, viewer_binary

__all__ = ["LOCAL_HOST", "WebViewer"]

LOCAL_HOST = "127.0.0.1"
DATA_PORT, PAGE_PORT = 9877, 9090
"""Another free one where somebody has it. Not 9876: whoever listens there is taken for a viewer's window."""
START_TIMEOUT_S = 20.0


class WebViewer:
    """Serves the viewer's page and its data until it is closed; a context manager.

    `address` is for the browser, `url` for a recorder that sends live. `files` are shown at once. `host`: the
    address to listen on; anything but 127.0.0.1 lets other machines look. Raises ViewerUnavailable.
    """

    def __init__(self, files: Sequence[Path] = (), *, host: str = LOCAL_HOST) -> None:
        data_port, page_port = _port(DATA_PORT), _port(PAGE_PORT)
        seen_at = socket.gethostname() if host in ("0.0.0.0", "::") else host
        self.url = f"rerun+http://{LOCAL_HOST}:{data_port}/proxy"
        shown = quote(f"rerun+http://{seen_at}:{data_port}/proxy", safe="")
        self.address = f"http://{seen_at}:{page_port}/?url={shown}"
        command = [
            str(viewer_binary()), "--serve-web", "--bind", host, "--port", str(data_port),
            "--web-viewer-port", str(page_port), "--server-memory-limit", VIEWER_MEMORY,
            *(str(file) for file in files),
        ]  # fmt: skip
        self._server = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=_end_with_parent if sys.platform.startswith("linux") else None,  # noqa: PLW1509
        )
        try:
            self._await((data_port, page_port), host)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def running(self) -> bool:
        """Whether it still serves."""
        return self._server.poll() is None

    def wait(self) -> None:
        """Serve until the user presses Ctrl-C, or the server ends by itself."""
        with contextlib.suppress(KeyboardInterrupt):
            self._server.communicate()

    def close(self) -> None:
        """End the server."""
        if self.running:
            self._server.terminate()
            try:
                self._server.communicate(timeout=5.0)
            except subprocess.TimeoutExpired:
                self._server.kill()
        self._server.communicate()

    def _await(self, ports: tuple[int, ...], host: str) -> None:
        reach = LOCAL_HOST if host in ("0.0.0.0", "::") else host
        deadline = time.monotonic() + START_TIMEOUT_S
        while not all(_listens(reach, port) for port in ports):
            if not self.running:
                said = (self._server.stderr.read() if self._server.stderr else "").strip().splitlines()
                reason = f": {said[-1]}" if said else ""
                raise ViewerUnavailable(f"the web viewer ended with code {self._server.returncode}{reason}")
            if time.monotonic() > deadline:
                raise ViewerUnavailable(f"the web viewer did not answer within {START_TIMEOUT_S:g} s")
            time.sleep(0.05)


def _end_with_parent() -> None:
    die_with_parent(signal.SIGTERM)  # also where nobody can close it: a command that was killed


def _port(wanted: int) -> int:
    return free_port() if _listens(LOCAL_HOST, wanted) else wanted


def _listens(host: str, port: int) -> bool:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.settimeout(0.2)
        return probe.connect_ex((host, port)) == 0
