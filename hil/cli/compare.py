"""`hil compare`: laws against each other on one scenario, on the nominal train and on drawn ones."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from controller.laws.selection import LAWS
from hil.bench.compare import Comparison, Request, compare
from hil.bench.comparison_files import JSON_FILE, write_files
from hil.bench.contender import contenders
from hil.bench.directory import new_run_directory
from hil.bench.errors import BenchError, ScenarioError
from hil.bench.run import counted_interrupts
from hil.bench.scenario import load_scenario
from hil.bench.sets import draws
from hil.bench.trial import TrialResult
from hil.cli.compare_tables import EXPLANATION, markdown, nominal_cells, number, screen, spread_cells
from hil.record.viewer import display_missing, start_viewer

DEFAULT_SCENARIO = "fuzzy_d_2km"
MOST_FAILURES_SHOWN = 3
PLAIN_EVERY_S = 10.0


def compare_(
    scenario: Annotated[
        str, typer.Argument(help="A shipped scenario (hil list) or a TOML file.")
    ] = DEFAULT_SCENARIO,
    laws: Annotated[
        str,
        typer.Option(help="all, or a list: pid,fuzzy_d. pid:paper is the law with the preset of that name."),
    ] = "all",
    runs: Annotated[
        int, typer.Option(min=0, help="Trains drawn from a set, beside the nominal run of each law.")
    ] = 0,
    set_of: Annotated[
        str, typer.Option("--set-of", help="Which set they are drawn from: spec or full.")
    ] = "spec",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws.")] = 1,
    jobs: Annotated[int, typer.Option(min=0, help="Processes; 0: one for each core.")] = 0,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the scenario.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory of the results; default: runs/<time>-compare-<scenario>.")
    ] = None,
    show: Annotated[bool, typer.Option("--view", help="Show the nominal runs in the Rerun viewer.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print compare.json and nothing else.")] = False,
) -> int:
    """Run control laws on the same scenario and put their numbers side by side.

    [bold]hil compare[/bold]                                         all laws, nominal train

    [bold]hil compare --laws all,all:paper[/bold]                    with the papers' raw gains as well

    [bold]hil compare --laws fuzzy_d --runs 200 --set-of full[/bold]  and against 200 trains of a set
    """
    console = Console(stderr=as_json)
    request = Request(
        scenario=scenario,
        contenders=contenders(laws, tuple(LAWS)),
        overrides=tuple(overrides or ()),
        runs=runs,
        set_name=set_of,
        seed=seed,
        jobs=jobs,
    )
    name = _checked(request)
    if out is not None and (out / JSON_FILE).exists():
        raise ScenarioError(f"--out {out}: already holds a comparison; choose another directory or remove it")
    if show and display_missing():
        console.print("no view: there is no display here; afterwards: hil view --web …", style="yellow")
        show = False
    folder = new_run_directory(out, f"compare-{name}")
    with counted_interrupts() as interrupted, _Live(Console(stderr=True), request) as live:
        comparison = compare(request, on_result=live.note, interrupted=interrupted)
    content = write_files(comparison, folder)
    _pictures(comparison, folder, show=show)
    if as_json:
        typer.echo(json.dumps(content, indent=2))
    else:
        report(console, comparison, folder)
    if comparison.done and not any(result.came_to_run for result in comparison.results):
        raise BenchError(f"no run could be made: {comparison.results[0].failure}")
    return 1 if comparison.interrupted else 0


def report(console: Console, comparison: Comparison, folder: Path) -> None:
    """Print the tables, what failed, and where the results are."""
    request = comparison.request
    console.print(screen(nominal_cells(comparison)))
    console.print(f"[dim]{EXPLANATION}[/dim]", highlight=False)
    _failures(console, "nominal", list(comparison.nominal.values()), most=len(request.contenders))
    drawn = spread_cells(comparison)
    if drawn.rows:
        console.print()
        console.print(screen(drawn))
        for results in comparison.drawn.values():
            _failures(console, "drawn", results)
    if comparison.interrupted:
        console.print(f"[yellow]interrupted: {comparison.done} of {request.total} runs were made[/yellow]")
    written = ", ".join(sorted(path.name for path in folder.iterdir()))
    console.print(f"\nresults: {folder}   {written}", highlight=False, soft_wrap=True)


def _checked(request: Request) -> str:
    """The scenario's name; errors of scenario, overrides, presets and set are told before anything runs."""
    name = request.scenario
    with tempfile.TemporaryDirectory(prefix="hil-") as scratch:
        drawn = draws(request.set_name, 1, request.seed)[0].overrides() if request.runs else ()
        _set_once(request, drawn)
        for contender in request.contenders:
            chosen = (*request.overrides, *contender.overrides())
            name = load_scenario(request.scenario, chosen, scratch=Path(scratch)).name
            load_scenario(request.scenario, (*chosen, *drawn), scratch=Path(scratch))
    return name


def _set_once(request: Request, drawn: Sequence[str]) -> None:
    """A value cannot be both the user's and the comparison's: one of them would be ignored in silence."""
    ours = dict.fromkeys(_keys(drawn), f"--set-of {request.set_name} draws it")
    ours["controller.law"] = "--laws chooses it"
    for key in _keys(request.overrides):
        if key in ours:
            raise ScenarioError(f"--set {key}: {ours[key]}; leave it out")


def _keys(overrides: Sequence[str]) -> list[str]:
    return [override.split("=", 1)[0].strip() for override in overrides]


def _pictures(comparison: Comparison, folder: Path, *, show: bool) -> None:
    # Only now: the libraries that draw are large.
    from hil.bench.comparison_picture import draw_picture
    from hil.bench.comparison_recording import record_comparison

    tables = [nominal_cells(comparison), *([spread_cells(comparison)] if comparison.drawn else [])]
    url = start_viewer() if show else None
    record_comparison(comparison, folder, markdown(tables), viewer_url=url)
    draw_picture(comparison, folder)


def _failures(
    console: Console, which: str, results: Sequence[TrialResult], *, most: int = MOST_FAILURES_SHOWN
) -> None:
    failed = [result for result in results if result.failure]
    for result in failed[:most]:
        who = f"{result.contender.name}, {which}" + (f" {result.draw.number}" if result.draw.number else "")
        console.print(f"[red]{who}: {escape(result.failure)}[/red]", soft_wrap=True, highlight=False)
    if len(failed) > most:
        console.print(f"[red]… and {len(failed) - most} more in {JSON_FILE}[/red]")


class _Live:
    """Progress over all runs, and how bad it has been so far; a line now and then without a terminal."""

    def __init__(self, console: Console, request: Request) -> None:
        self._console = console
        self._done, self._failed, self._total = 0, 0, request.total
        self._worst: tuple[float, str] = (0.0, "")
        self._printed_s = time.monotonic()
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[told]}"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("runs", total=request.total, told="")

    def __enter__(self) -> _Live:
        self._bar.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._bar.stop()

    def note(self, result: TrialResult) -> None:
        self._done += 1
        self._failed += bool(result.failure)
        stop = result.metrics.stop_error_m
        if stop is not None and abs(stop) > self._worst[0]:
            train = f"draw {result.draw.number}" if result.draw.number else "nominal"
            self._worst = (abs(stop), f"{result.contender.name} {train}")
        told = f"{self._failed} failed   worst stop {number(self._worst[0], 3)} m {self._worst[1]}"
        self._bar.update(self._task, completed=self._done, told=told)
        now = time.monotonic()
        if not self._console.is_terminal and now - self._printed_s >= PLAIN_EVERY_S:
            self._printed_s = now
            self._console.print(f"{self._done} of {self._total} runs   {told}", highlight=False)
