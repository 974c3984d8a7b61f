"""Where a run leaves its results: a directory of its own, never one that holds a recording."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from hil.bench.errors import ScenarioError


def new_run_directory(out: Path | None, scenario_name: str) -> Path:
    """Create the directory of a run: the one given (which must not hold a run), or runs/<time>-<name>.

    Raises ScenarioError if a recording is already there: nothing recorded is ever lost.
    """
    if out is None:
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        base = Path("runs") / f"{stamp}-{scenario_name}"
        out = base
        for number in range(2, 1000):
            if not out.exists():
                break
            out = base.with_name(f"{base.name}-{number}")
    elif (out / "run.rrd").exists():
        raise ScenarioError(f"--out {out}: already holds a recording; choose another directory or remove it")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError(f"--out {out}: cannot be created: {error.strerror}") from None
    return out
