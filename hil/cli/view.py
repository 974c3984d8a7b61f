"""`hil view`: open recordings in the Rerun viewer, or draw their pages into pictures."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from hil.bench.errors import BenchError, ScenarioError
from hil.record.viewer import display_missing, viewer_binary
from hil.record.web_viewer import LOCAL_HOST, WebViewer

COMPARISON = "compare.rrd"


def view(
    runs: Annotated[list[Path], typer.Argument(help="Run directories or .rrd files.")],
    web: Annotated[bool, typer.Option("--web", help="Serve the viewer to a browser until Ctrl-C.")] = False,
    host: Annotated[
        str, typer.Option(help="With --web: address to listen on; 0.0.0.0 lets other machines look.")
    ] = LOCAL_HOST,
    render: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Draw every page into a PNG file there; needs no display."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Say as JSON what is shown: address, or pictures by page.")
    ] = False,
) -> None:
    """Open a recording in the Rerun viewer, or several on one time axis.

    [bold]hil view runs/20260101-120000-cat_linh_la_thanh[/bold]    the dashboard of one run

    [bold]hil view runs/a runs/b[/bold]                             speed, error, effort of both, overlaid

    [bold]hil view runs/a --render build/pictures[/bold]            drive.png, law.png, … without a display

    [bold]hil view runs/a --web --host 0.0.0.0[/bold]               from a machine without a screen
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
            _render(shown, render, as_json=as_json)
            return
        if web:
            with WebViewer([shown], host=host) as viewer:
                typer.echo(
                    json.dumps({"recordings": [str(file) for file in files], "address": viewer.address})
                    if as_json
                    else f"{viewer.address}   (Ctrl-C ends it)"
                )
                viewer.wait()
            return
        if as_json:
            typer.echo(json.dumps({"recordings": [str(file) for file in files], "address": None}))
        code = subprocess.call([str(viewer_binary()), str(shown)])
    if code not in (0, 130, -2):
        raise BenchError(f"the Rerun viewer ended with exit code {code}; hil doctor says what it needs")


def _render(rrd: Path, folder: Path, *, as_json: bool) -> None:
    from hil.record.render import render_all

    drawn = {name: str(file) for name, file in render_all(rrd, folder).items()}
    typer.echo(json.dumps({"pictures": drawn}, indent=2) if as_json else "\n".join(drawn.values()))


def recording(run: Path) -> Path:
    """The recording of a run directory, or the file itself."""
    path = run / "run.rrd" if run.is_dir() else run
    if not path.is_file():
        raise ScenarioError(
            f"{run}: no recording there (expected a run directory with run.rrd, or an .rrd file)"
        )
    return path
