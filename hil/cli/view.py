"""`hil view`: open recordings in the Rerun viewer."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Annotated

import typer

from hil.bench.errors import BenchError, ScenarioError
from hil.record.viewer import display_missing, viewer_binary


def view(
    runs: Annotated[list[Path], typer.Argument(help="Run directories or .rrd files.")],
    web: Annotated[bool, typer.Option("--web", help="Serve the web viewer instead of a window.")] = False,
) -> None:
    """Open one or more recordings in the Rerun viewer, side by side.

    [bold]hil view runs/20260101-120000-cat_linh_la_thanh[/bold]
    """
    files = [str(recording(run)) for run in runs]
    if web:
        command = [str(viewer_binary()), "--serve-web", *files]
    elif display_missing():
        raise BenchError(
            "no display for the viewer (DISPLAY and WAYLAND_DISPLAY are empty): use --web and open the"
            " printed address in a browser, or copy the .rrd to a desktop"
        )
    else:
        command = [str(viewer_binary()), *files]
    code = subprocess.call(command)
    if code not in (0, 130, -2):
        raise BenchError(f"the Rerun viewer ended with exit code {code}; hil doctor says what it needs")


def recording(run: Path) -> Path:
    """The recording of a run directory, or the file itself."""
    path = run / "run.rrd" if run.is_dir() else run
    if not path.is_file():
        raise ScenarioError(
            f"{run}: no recording there (expected a run directory with run.rrd, or an .rrd file)"
        )
    return path
