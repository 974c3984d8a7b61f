"""`hil view`: open recordings in the Rerun viewer, or draw their pages into pictures."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from hil.bench.errors import BenchError, ScenarioError
from hil.record.viewer import display_missing, viewer_binary

COMPARISON = "compare.rrd"


def view(
    runs: Annotated[list[Path], typer.Argument(help="Run directories or .rrd files.")],
    web: Annotated[bool, typer.Option("--web", help="Serve the web viewer instead of a window.")] = False,
    render: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Draw every page into a PNG file there; needs no display."),
    ] = None,
) -> None:
    """Open a recording in the Rerun viewer, or several on one time axis.

    [bold]hil view runs/20260101-120000-cat_linh_la_thanh[/bold]    the dashboard of one run

    [bold]hil view runs/a runs/b[/bold]                             speed, error, effort of both, overlaid

    [bold]hil view runs/a --render build/pictures[/bold]            drive.png, law.png, … without a display
    """
    files = [recording(run) for run in runs]
    if not web and render is None and display_missing():
        raise BenchError(
            "no display for the viewer (DISPLAY and WAYLAND_DISPLAY are empty): use --web and open the"
            " printed address in a browser, or --render DIR for pictures"
        )
    with tempfile.TemporaryDirectory(prefix="hil-view-") as scratch:
        shown = files[0]
        if len(files) > 1:
            from hil.record.comparison import record_comparison

            shown = record_comparison(runs, Path(scratch) / COMPARISON)
        if render is not None:
            _render(shown, render)
            return
        command = [str(viewer_binary()), *(["--serve-web"] if web else []), str(shown)]
        code = subprocess.call(command)
    if code not in (0, 130, -2):
        raise BenchError(f"the Rerun viewer ended with exit code {code}; hil doctor says what it needs")


def _render(rrd: Path, folder: Path) -> None:
    from hil.record.render import render_all

    for file in render_all(rrd, folder).values():
        typer.echo(str(file))


def recording(run: Path) -> Path:
    """The recording of a run directory, or the file itself."""
    path = run / "run.rrd" if run.is_dir() else run
    if not path.is_file():
        raise ScenarioError(
            f"{run}: no recording there (expected a run directory with run.rrd, or an .rrd file)"
        )
    return path
