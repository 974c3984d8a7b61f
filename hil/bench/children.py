"""A child process of a run: started with its output kept, watched, and ended in good order."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.bench.errors import BenchError


def _nothing() -> None:
    pass


class Child:
    """One process of a run (`name` is what the user reads), started as `python -m module …`.

    Its standard error goes to `<logs>/<name>.log`; it is in a session of its own, so that Ctrl-C
    reaches the launcher alone, which then ends the children in the right order.
    """

    def __init__(self, name: str, module: str, arguments: Sequence[str], *, logs: Path) -> None:
        logs.mkdir(parents=True, exist_ok=True)
        self.name = name
        self.log = logs / f"{name}.log"
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env=environment,
                start_new_session=True,
            )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """Exit code once ended (negative: ended by that signal), else None."""
        return self._process.poll()

    @property
    def running(self) -> bool:
        """Whether the process still runs."""
        return self.returncode is None

    def wait_for_line(self, text: str, timeout_s: float, check: Callable[[], None] = _nothing) -> None:
        """Wait until the child prints `text` on standard output; `check` may raise to end the wait.

        Raises BenchError.
        """
        deadline = time.monotonic() + timeout_s
        stream = self._process.stdout
        if stream is None:  # pragma: no cover - always piped
            return
        os.set_blocking(stream.fileno(), False)
        seen = b""
        while text.encode() not in seen:
            seen += stream.read() or b""
            check()
            self._check_start(deadline, timeout_s)
            time.sleep(0.005)

    def wait_for_file(
        self, path: Path, key: str, value: str, timeout_s: float, check: Callable[[], None] = _nothing
    ) -> None:
        """Wait until the JSON file `path` says `key: value`; otherwise as `wait_for_line`."""
        deadline = time.monotonic() + timeout_s
        while read_json(path).get(key) != value:
            check()
            self._check_start(deadline, timeout_s)
            time.sleep(0.005)

    def signal(self, number: int) -> None:
        """Send a signal if the child still runs."""
        if self.running:
            try:
                self._process.send_signal(number)
            except ProcessLookupError:  # it ended between the two lines
                return

    def wait(self, timeout_s: float) -> None:
        """Wait until the child has ended, at most `timeout_s`."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)

    def end(self, timeout_s: float = 10.0) -> int:
        """SIGTERM, wait, and SIGKILL only if it does not listen; the exit code."""
        self.signal(signal.SIGTERM)
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()
        finally:
            for stream in (self._process.stdin, self._process.stdout):
                if stream is not None:
                    stream.close()

    def last_words(self) -> str:
        """The last line that the child wrote on standard error, or how it ended."""
        try:
            lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        except OSError:
            lines = []
        code = self.returncode
        if code is not None and code < 0:
            return f"{self.name}: killed by {_signal_name(-code)}"
        if lines:
            return lines[-1] if lines[-1].startswith(self.name) else f"{self.name}: {lines[-1]}"
        return f"{self.name}: ended with exit code {code}"

    def _check_start(self, deadline: float, timeout_s: float) -> None:
        if not self.running:
            error = BenchError(self.last_words())
            if self.returncode == 2:
                error.exit_code = 2
            raise error
        if time.monotonic() > deadline:
            raise BenchError(f"{self.name}: not ready after {timeout_s:g} s; see {self.log}")


def read_json(path: Path) -> Mapping[str, Any]:
    """A JSON object from a file that may not be there yet (then empty)."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _signal_name(number: int) -> str:
    try:
        return f"signal {number} ({signal.Signals(number).name})"
    except ValueError:
        return f"signal {number}"
