"""The Rerun viewer as a program: where it is, whether a window can open, and starting one beside a run."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from hil.record.errors import ViewerUnavailable

__all__ = ["display_missing", "free_port", "start_viewer", "viewer_binary"]

VIEWER_PORT = 9876
VIEWER_MEMORY = "25%"


def viewer_binary() -> Path:
    """The viewer's executable that comes with rerun-sdk. Raises ViewerUnavailable.

    Not the script on the PATH: that one is a wrapper in Python, and ending it leaves the viewer behind.
    """
    package = find_spec("rerun_cli")
    for folder in (package.submodule_search_locations or []) if package else []:
        for name in ("rerun", "rerun.exe"):
            if (Path(folder) / name).is_file():
                return Path(folder) / name
    raise ViewerUnavailable(
        "the Rerun viewer is missing: install rerun-sdk with its viewer (pip install rerun-sdk)"
    )


def display_missing() -> bool:
    """Whether no window can open here: Linux without X or Wayland."""
    return sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def free_port() -> int:
    """A TCP port on this host that nobody listens on right now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def start_viewer(timeout_s: float = 15.0) -> str:
    """Open a viewer window that outlives this process; the address to send to. Raises ViewerUnavailable.

    A viewer that listens already is used as it is.
    """
    url = f"rerun+http://127.0.0.1:{VIEWER_PORT}/proxy"
    if _listens(VIEWER_PORT):
        return url
    if display_missing():
        raise ViewerUnavailable(
            "no live view: no display (DISPLAY and WAYLAND_DISPLAY are empty);"
            " see the recording afterwards with hil view --web"
        )
    command = [
        str(viewer_binary()),
        "--port", str(VIEWER_PORT),
        "--bind", "127.0.0.1",
        "--memory-limit", VIEWER_MEMORY,
        "--hide-welcome-screen",
    ]  # fmt: skip
    viewer = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    deadline = time.monotonic() + timeout_s
    while not _listens(VIEWER_PORT):
        if viewer.poll() is not None:
            raise ViewerUnavailable(
                f"no live view: the Rerun viewer ended with code {viewer.returncode};"
                " hil doctor says what it needs"
            )
        if time.monotonic() > deadline:
            raise ViewerUnavailable(f"no live view: the Rerun viewer did not answer within {timeout_s:g} s")
        time.sleep(0.05)
    return url


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(0.2)
        return probe.connect_ex(("127.0.0.1", port)) == 0
