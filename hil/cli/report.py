"""`hil report`: the report of a run again, or several runs beside each other."""

from __future__ import annotations

import json
import webbrowser
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from hil.record.viewer import display_missing


def report(
    runs: Annotated[list[Path], typer.Argument(help="Run directories; two or more are compared.")],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The file to write [RUN/report.html; of a comparison: comparison.html beside the first run]."
        ),
    ] = None,
    show: Annotated[bool, typer.Option("--open", help="Open it in the browser.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document and nothing else.")] = False,
) -> None:
    """Write the report of a run from its directory, or compare runs.

    [bold]hil report runs/a[/bold]                 runs/a/report.html, as hil run leaves it

    [bold]hil report runs/a runs/b --open[/bold]   criteria side by side, curves over each other

    [bold]hil report runs/a --out a.html[/bold]    one file to mail: no network, no script
    """
    # Only now: the libraries that read a recording are large.
    from hil.bench.report import write_comparison, write_report

    console = Console(stderr=True, soft_wrap=True, highlight=False)
    with console.status("reading the recordings"):
        written = write_report(runs[0], out) if len(runs) == 1 else write_comparison(runs, out)
    if as_json:
        typer.echo(json.dumps(written.as_dict(), indent=2))
    else:
        for line in written.missing:
            console.print(f"missing: {line}", style="yellow", markup=False)
        typer.echo(f"report: {written.path}   {written.bytes / 1e3:.0f} kB")
    if show and (display_missing() or not webbrowser.open(written.path.resolve().as_uri())):
        console.print(
            f"no browser could be opened here; open {written.path} yourself", style="yellow", markup=False
        )
