"""`hil list`: what there is to run."""

from __future__ import annotations

import json
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from controller.laws.selection import LAWS
from hil.railway.library import list_lines, list_scenarios, list_trains


def list_(
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> None:
    """List the shipped scenarios, lines and trains, and the control laws.

    [bold]hil list[/bold]           what hil run, hil profile and --law take

    [bold]hil list --json[/bold]    for scripts
    """
    found = {
        "scenarios": {entry.name: entry.title for entry in list_scenarios()},
        "lines": {entry.name: entry.title for entry in list_lines()},
        "trains": {entry.name: entry.title for entry in list_trains()},
        "laws": {name: entry.title for name, entry in LAWS.items()},
    }
    if as_json:
        typer.echo(json.dumps(found, indent=2, ensure_ascii=False))
        return
    console = Console()
    for kind, rows in found.items():
        table = Table(kind[:-1], "title", title=kind, title_justify="left", box=None, pad_edge=False)
        for name, title in rows.items():
            table.add_row(f"[bold]{name}[/bold]", title)
        console.print(table)
        console.print()
    console.print("Run one: [bold]hil run SCENARIO --law LAW[/bold]; your own: [bold]hil run my.toml[/bold]")
