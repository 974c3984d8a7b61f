"""`hil query`: numbers out of a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from hil.bench.errors import ScenarioError

if TYPE_CHECKING:
    from hil.record import RunData
    from hil.record.expressions import Quantity


def query(
    run: Annotated[Path, typer.Argument(help="A run directory, an .rrd file, or a frame log.")],
    expressions: Annotated[
        list[str] | None, typer.Argument(metavar="[EXPRESSION]...", help="What to compute.")
    ] = None,
    show_list: Annotated[
        bool, typer.Option("--list", help="List the signals with unit and number of samples.")
    ] = False,
    dbc: Annotated[Path | None, typer.Option(help="DBC of a frame log; a recording carries its own.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document and nothing else.")] = False,
) -> None:
    """Ask a recording for numbers.

    [bold]hil query RUN --list[/bold]                            what there is

    [bold]hil query RUN "max(ODO_Motion.Speed)"[/bold]           one number, with its unit

    [bold]hil query RUN "max(abs(ODO_Motion.Speed - ATO_Status.ReferenceSpeed))"[/bold]

    [bold]hil query RUN "rms(where(controller.speed_error_mps, ODO_Motion.Speed > 10))"[/bold]

    Signals are Message.Signal; what a process computes inside, the plant's true values among it, is
    process.name. Two signals meet at the stamps of the left one; the other holds its latest value.

    Functions: max min mean rms std p50 p99 p999 percentile(x, 95) count first last sum abs sqrt diff rate
    where(x, condition) between(x, t0, t1) at(x, t) time(x).
    """
    if not show_list and not expressions:
        raise ScenarioError("hil query: no expression; give one, or --list to see what there is to ask for")
    from hil.record import open_run
    from hil.record.expressions import evaluate

    recording = open_run(run, dbc=dbc)
    if recording.warning:
        typer.echo(f"hil query: {recording.warning}", err=True)
    if show_list:
        _list(recording, as_json)
        return
    answers = {text: evaluate(text, recording.__getitem__) for text in expressions or []}
    if as_json:
        typer.echo(json.dumps({text: _as_dict(answer) for text, answer in answers.items()}, indent=2))
        return
    for text, answer in answers.items():
        prefix = f"{text} = " if len(answers) > 1 else ""
        typer.echo(f"{prefix}{_as_text(answer)}")


def _list(recording: RunData, as_json: bool) -> None:
    if as_json:
        rows = [{"name": s.name, "unit": s.unit, "samples": s.samples} for s in recording.signals]
        typer.echo(json.dumps(rows, indent=2))
        return
    table = Table("signal", "unit", "samples", box=None, pad_edge=False)
    table.columns[2].justify = "right"
    for signal in recording.signals:
        table.add_row(signal.name, signal.unit, str(signal.samples))
    Console(soft_wrap=True, highlight=False).print(table)


def _as_text(answer: Quantity) -> str:
    unit = f" {answer.unit}" if answer.unit not in {"", "1"} else ""
    if not answer.is_series:
        return f"{float(answer.values):.6g}{unit}"
    count = len(answer.values)
    if not count:
        return "no samples"
    low, high = answer.values.min(), answer.values.max()
    return f"{count} samples from {low:.6g} to {high:.6g}{unit} (--json gives them all)"


def _as_dict(answer: Quantity) -> dict[str, Any]:
    if not answer.is_series or answer.seconds is None:
        return {"value": _number(float(answer.values)), "unit": answer.unit}
    return {
        "values": [_number(value) for value in answer.values.tolist()],
        "sim_time_s": answer.seconds.tolist(),
        "unit": answer.unit,
    }


def _number(value: float) -> float | None:
    """JSON has no not-a-number and no infinity."""
    return value if abs(value) < float("inf") else None
