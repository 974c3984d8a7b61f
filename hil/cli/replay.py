"""`hil replay`: a recorded log against one node, ours or a device. Does it answer as the recorded one did?"""

from __future__ import annotations

import json
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from hil.bench.errors import ScenarioError
from hil.cli.completion import complete_runs
from hil.cli.run import bus_options, check_priority

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
    node: Annotated[
        str, typer.Option(help="controller or plant_sim; with --live also a node of the DBC.")
    ] = "controller",
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
    live: Annotated[
        bool, typer.Option("--live", help="To a device on a bus, in real time, as its restbus.")
    ] = False,
    start_node: Annotated[
        bool, typer.Option("--start-node", help="Live: start our own node as the device.")
    ] = False,
    until: Annotated[
        float | None, typer.Option(metavar="S", help="Live: play only so much [s] of the recording.")
    ] = None,
    settle: Annotated[
        float,
        typer.Option(metavar="S", help="Live: what deviates so soon after the start does not count [s]."),
    ] = 1.0,
    wait: Annotated[
        float | None, typer.Option(metavar="S", help="Live: wait so long for the device to speak [10 s].")
    ] = None,
    priority: Annotated[
        int, typer.Option(help="Live: SCHED_FIFO priority, 1 to 88; 0: do not ask for it.")
    ] = 50,
    interface: Annotated[
        str | None, typer.Option("-i", "--interface", help="Live: python-can interface.")
    ] = None,
    channel: Annotated[str | None, typer.Option("-c", "--channel", help="Live: channel of the bus.")] = None,
    bitrate: Annotated[int | None, typer.Option("-b", "--bitrate", help="Live: bit rate [bit/s].")] = None,
    fd: Annotated[bool, typer.Option("--fd", help="Live: open the bus for CAN FD.")] = False,
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

    [bold]hil replay RUN --live -i socketcan -c can0[/bold]
    to an ATO of your own on a real bus; --start-node puts ours there
    """
    # Only now: help and bad input do not wait for compilers and readers.
    from hil.bench.replay import LiveOptions, ReplayRequest, replay_live
    from hil.bench.replay import replay as play
    from hil.bench.replay.document import document
    from hil.bench.run import counted_interrupts

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
    options = None
    if live:
        _check_live(until, settle, wait, priority)
        options = LiveOptions(
            bus=bus_options(None, interface, channel, bitrate, fd, []),
            start_node=start_node, until_s=until, settle_s=settle, wait_s=wait, priority=priority,
        )  # fmt: skip
        if options.bus.interface == "virtual":
            raise ScenarioError(
                "-i virtual: no device can be on a bus inside this process; use -i hil or socketcan"
            )
    else:
        _only_live(start_node, until, wait, interface, channel, bitrate, fd)
    progress = Progress(
        TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn(),
        console=Console(stderr=True), transient=True,
        # Drawing takes milliseconds, which a restbus in real time has to wait for.
        refresh_per_second=1 if live else 10,
    )  # fmt: skip
    progress.disable = not progress.console.is_terminal
    with progress:
        task = progress.add_task(f"replaying {log.name} to {node}", total=1.0)

        def show(share: float) -> None:
            progress.update(task, completed=share)

        if options is None:
            result = play(request, show=show)
        else:
            with counted_interrupts() as interrupted:
                result = replay_live(
                    request, options, show=show, interrupted=interrupted,
                    tell=lambda line: progress.console.print(line, highlight=False),
                )  # fmt: skip
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


def _check_live(until: float | None, settle: float, wait: float | None, priority: int) -> None:
    if not (isfinite(settle) and settle >= 0.0):
        raise ScenarioError(f"--settle {settle:g}: must be a number of seconds, 0 or more")
    for name, value in (("until", until), ("wait", wait)):
        if value is not None and not (isfinite(value) and value > 0.0):
            raise ScenarioError(f"--{name} {value:g}: must be a number of seconds, above 0")
    check_priority(priority)


def _only_live(
    start_node: bool,
    until: float | None,
    wait: float | None,
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    fd: bool,
) -> None:
    """Raises ScenarioError for an option that would be obeyed in silence."""
    given = {
        "--start-node": start_node,
        "--until": until is not None,
        "--wait": wait is not None,
        "-i": interface is not None,
        "-c": channel is not None,
        "-b": bitrate is not None,
        "--fd": fd,
    }
    for name, is_given in given.items():
        if is_given:
            raise ScenarioError(
                f"{name}: only with --live; without it the node runs in this process, with no bus"
            )


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
