"""`hil study`: a paper's own experiment with our laws, its numbers beside ours."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Annotated

import typer
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from hil.bench.directory import new_run_directory
from studies.errors import StudyError
from studies.registry import STUDIES, entry
from studies.study import Study, study_json
from studies.table import Row, summary_line

WIDE = 130
"""From this many characters on the reason stands in a column of its own."""


def study(
    name: Annotated[str | None, typer.Argument(help="The study; without it they are listed.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory of the results; default: runs/<time>-study-<name>.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print study.json and nothing else.")] = False,
    show: Annotated[bool, typer.Option("--view", help="Open the recording in the Rerun viewer.")] = False,
) -> int:
    """Repeat a paper's experiment: table, a picture for each figure, recording.

    [bold]hil study[/bold]         what there is

    [bold]hil study fsmc[/bold]    the sliding-mode paper's Table 3 beside ours

    A number that is not reproduced is a result and no failure: the exit code is 0 when the study ran.
    """
    if name is None:
        _list(as_json)
        return 0
    chosen = entry(name)
    if out is not None and (out / "study.rrd").exists():
        raise StudyError(f"--out {out}: already holds a study; choose another directory or remove it")
    directory = new_run_directory(out, f"study-{chosen.name}")
    console = Console(stderr=as_json)
    # Only now: bad input is told before the laws have been loaded and compiled.
    from studies.report import RECORDING_FILE, write

    with _Bar(Console(stderr=True)) as progress:
        result = chosen.run(progress)
        files = write(result, directory, progress)
    if as_json:
        typer.echo(json.dumps(study_json(result), indent=2, ensure_ascii=False))
    else:
        report(console, result)
        console.print(
            f"\npictures: {len(files) - 3} PNG in {directory}   recording: hil view"
            f" {directory / RECORDING_FILE}",
            highlight=False,
            soft_wrap=True,
        )
    if show:
        from hil.cli.view import view

        view([directory / RECORDING_FILE])
    return 0


def report(console: Console, result: Study) -> None:
    """Print the table, then what the paper contradicts and what was assumed."""
    console.print(f"[bold]{result.title}[/bold]\n[dim]{result.paper}[/dim]\n", highlight=False)
    widths = _Widths.fitting(console, result.rows)
    console.print(
        widths.line("quantity", "unit", "paper", "ours", "ratio", "reproduced", "why"), style="bold"
    )
    group = ""
    for row in result.rows:
        if row.group != group:
            group = row.group
            console.print(f"\n[bold cyan]{group}[/bold cyan]")
        numbers = _number(row.paper), _number(row.ours), _number(row.ratio, 3)
        console.print(
            widths.line(row.quantity, row.unit, *numbers, _verdict(row), _why(row)), highlight=False
        )
    console.print(f"\n[bold]{summary_line(result.rows)}[/bold]", highlight=False)
    for head, mark, sentences in (
        ("Where the paper contradicts itself or physics", "[red]![/red]", result.contradictions),
        ("Assumptions", "[dim]-[/dim]", result.assumptions),
    ):
        if sentences:
            console.print(f"\n[bold]{head}[/bold]")
            for sentence in sentences:
                console.print(f" {mark} {sentence}", highlight=False)


@dataclass(frozen=True)
class _Widths:
    """Columns that stay aligned over all groups; on a narrow terminal the reason stands below its row."""

    quantity: int
    unit: int
    wide: bool

    @classmethod
    def fitting(cls, console: Console, rows: Sequence[Row]) -> _Widths:
        wide = console.width >= WIDE
        unit = max(len(row.unit) for row in rows)
        room = console.width - max(unit, 4) - 46 - (40 if wide else 0)
        return cls(min(max(len(row.quantity) for row in rows), max(room, 20)), max(unit, 4), wide)

    def line(
        self, quantity: str, unit: str, paper: str, ours: str, ratio: str, verdict: str, why: str
    ) -> RenderableType:
        grid = Table.grid(padding=(0, 2, 0, 0))
        grid.add_column(width=self.quantity)
        grid.add_column(width=self.unit)
        for width in (9, 9, 6):
            grid.add_column(width=width, justify="right")
        grid.add_column(width=10)
        cells = [quantity, unit, paper, ours, ratio, verdict]
        if self.wide:
            grid.add_column()
            cells.append(why)
        grid.add_row(*cells)
        if self.wide or not why or why == "why":
            return grid
        return Group(grid, Padding(Text.from_markup(why, style="dim"), (0, 0, 0, 4)))


def _verdict(row: Row) -> str:
    return {True: "[green]yes[/green]", False: "[yellow]no[/yellow]", None: "[dim]-[/dim]"}[row.reproduced]


def _why(row: Row) -> str:
    """The note, and with a "no" how near it would have had to be."""
    if row.reproduced is not False:
        return row.note
    return f"not within {row.tolerance}" + (f": {row.note}" if row.note else "")


def _number(value: float | None, digits: int = 4) -> str:
    """As many digits as say something: 4.063e+05, 0.0393, 15.3."""
    if value is None:
        return "-"
    if value != 0.0 and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{digits}g}"


def _list(as_json: bool) -> None:
    if as_json:
        rows = [{"name": s.name, "title": s.title, "paper": s.paper} for s in STUDIES.values()]
        typer.echo(json.dumps({"studies": rows}, indent=2, ensure_ascii=False))
        return
    table = Table("study", "title", "paper", box=None, pad_edge=False)
    for item in STUDIES.values():
        table.add_row(f"[bold]{item.name}[/bold]", item.title, f"[dim]{item.paper}[/dim]")
    console = Console()
    console.print(table, highlight=False)
    console.print("\nRun one: [bold]hil study NAME[/bold]")


class _Bar:
    """Progress of a study on a terminal; a line for each new step where there is none."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("starting", total=1.0)
        self._what = ""

    def __enter__(self) -> Callable[[str, float], None]:
        self._bar.start()
        return self._show

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def _show(self, what: str, done: float) -> None:
        if what != self._what and not self._console.is_terminal:
            self._console.print(f"{what} …", style="dim", highlight=False)
        self._what = what
        self._bar.update(self._task, description=what, completed=done)
