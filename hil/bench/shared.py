"""What runs share with others on this machine: the bus, which one bench at a time may drive, and memory."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hil.canbus.transport import BusOptions

FOLDER_NAME = re.compile(r"hil-run-(\d+)-\w+")


@contextmanager
def shared_folder() -> Iterator[Path]:
    """A folder in memory for rings and status files, gone when the run is.

    Folders of runs that were killed are removed on the way: each holds some 20 MB of memory.
    """
    memory = Path("/dev/shm")
    usable = memory.is_dir() and os.access(memory, os.W_OK)
    base = memory if usable else Path(tempfile.gettempdir())
    for left in base.glob("hil-run-*"):
        match = FOLDER_NAME.fullmatch(left.name)
        if match and not _lives(int(match[1])):
            shutil.rmtree(left, ignore_errors=True)
    folder = Path(tempfile.mkdtemp(prefix=f"hil-run-{os.getpid()}-", dir=base))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class BusClaim:
    """The right to drive a bus from this machine, held from before the first frame to after the last.

    Listening alone cannot tell: a bench that is still starting its nodes says nothing yet.
    """

    def __init__(self) -> None:
        self._file: int | None = None

    def take(self, bus: BusOptions) -> bool:
        """Claim the bus; False if another bench on this machine has it. Always True where files cannot be
        locked (not POSIX).
        """
        self.release()
        if sys.platform == "win32":
            return True
        import fcntl

        name = re.sub(r"\W", "_", f"{bus.interface}-{bus.channel}")
        path = Path(tempfile.gettempdir()) / f"hil-bench-{name}.lock"
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError:  # another user's file: that user's bench would be heard, if it speaks
            return True
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(file)
            return False
        self._file = file
        return True

    def release(self) -> None:
        """Give the bus back."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                os.close(self._file)
            self._file = None


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
