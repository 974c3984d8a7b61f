"""`hil replay`: a recorded log against one node. Does this version still answer as the recorded one did?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from hil.bench.errors import ScenarioError
from hil.cli.completion import complete_runs

if TYPE_CHECKING:
    from hil.bench.replay import Replayed

EXIT_MATCH, EXIT_DEVIATES = 0, 1


def replay(
    log: Annotated[
        Path,
        typer.Argument(
            metavar="RUN|LOG",
            help="A run directory, or a frame log: .blf .asc .log .trc .mf4.",
            autocompletion=complete_runs,
        ),
    ],
    node: Annotated[str, typer.Option(help="controller or plant_sim.")] = "controller",
    tolerance: Annotated[
        list[str] | None,
        typer.Option(metavar="MESSAGE.SIGNAL=VALUE", help="In the DBC's unit; * allowed in the name."),
    ] = None,
    ignore: Annotated[
        list[str] | None,
        typer.Option(metavar="MESSAGE[.SIGNAL]", help="Do not compare; * allowed."),
    ] = None,
    rules: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Tolerances and ignore list as TOML.")
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option(help="What the log is a run of [RUN/scenario.toml]."),
    ] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override a value of the scenario.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write replay.json and replay.png there.")
    ] = None,
    dbc: Annotated[Path | None, typer.Option(help="Another DBC with the bench's messages.")] = None,
    show_all: Annotated[bool, typer.Option("--all", help="List what is ignored, too.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document and nothing else.")] = False,
) -> int:
    """Play a recorded log to one node and compare its answers with the recorded ones.

    Everything that the others sent is put to the node at its recorded time, as fast as it goes. A
    recording in lockstep has to match to the last bit; ignored are E2E counters, CRC and *_Timing.

    [bold]hil replay RUN[/bold]
    does today's controller answer as in RUN?

    [bold]hil replay RUN --set controller.law=pid --out cmp[/bold]
    what would the PID law have done?

    [bold]hil replay log.asc --scenario metro_1500m --node plant_sim[/bold]
    a log of another tool, put to the plant

    [bold]hil replay RUN --tolerance ATO_Command.EffortDemand=1[/bold]
    one percent of effort is no deviation
    """
    # Only now: help and bad input do not wait for compilers and readers.
    from hil.bench.replay import ReplayRequest
    from hil.bench.replay import replay as play
    from hil.bench.replay.document import document

    request = ReplayRequest(
        log=log,
        node=node,
        scenario=scenario,
        overrides=overrides or (),
        tolerances=tolerance or (),
        ignore=ignore or (),
        rules=rules,
        dbc=dbc,
    )
    progress = Progress(
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn(),
        console=Console(stderr=True), transient=True,
    )  # fmt: skip
    progress.disable = not progress.console.is_terminal
    with progress:
        task = progress.add_task(f"replaying {log.name} to {node}", total=1.0)
        result = play(request, show=lambda share: progress.update(task, completed=share))
    told = document(result)
    written = _write(result, told, out) if out is not None else []
    if as_json:
        typer.echo(json.dumps(told, indent=2))
    else:
        from hil.cli.replay_table import print_result

        print_result(Console(), result, show_all=show_all)
        for path in written:
            typer.echo(f"written: {path}")
    return EXIT_MATCH if result.comparison.matches else EXIT_DEVIATES


def _write(result: Replayed, told: dict[str, Any], out: Path) -> list[Path]:
    from hil.bench.replay.picture import draw_picture

    try:
        out.mkdir(parents=True, exist_ok=True)
        path = out / "replay.json"
        path.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
        picture = draw_picture(result, out)
    except OSError as error:
        raise ScenarioError(f"--out {out}: cannot be written: {error.strerror or error}") from None
    return [path] if picture is None else [path, picture]
