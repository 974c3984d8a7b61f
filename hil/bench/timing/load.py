"""Every core busy: stress-ng if it is installed, else processes that count."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["busy"]

RAMP_S = 0.5
HOG = "n = 0\nwhile True:\n    n = (n * 1103515245 + 12345) % 2147483648\n"


@contextmanager
def busy() -> Iterator[str]:
    """Keep every core busy at normal priority while the context lasts; says with what."""
    cores = os.cpu_count() or 1
    program = shutil.which("stress-ng")
    if program is not None:
        lines = [[program, "--cpu", str(cores), "--switch", "1", "--vm", "1", "--vm-bytes", "64M", "--quiet"]]
        told = f"stress-ng --cpu {cores} --switch 1 --vm 1"
    else:
        lines = [[sys.executable, "-c", HOG]] * cores
        told = f"{cores} counting processes (stress-ng is not installed)"
    # A session each: the parent of stress-ng ends its workers, but only if it is told itself.
    hogs = [
        subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        for line in lines
    ]
    try:
        time.sleep(RAMP_S)
        yield told
    finally:
        for hog in hogs:
            hog.terminate()
        for hog in hogs:
            with contextlib.suppress(subprocess.TimeoutExpired):
                hog.wait(5.0)
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(hog.pid, signal.SIGKILL)
            hog.wait()
