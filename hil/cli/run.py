"""`hil run`: the main job. Drives a train from station to station and says whether it passed."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.table import Table

from hil.bench.directory import new_run_directory
from hil.bench.errors import ScenarioError
from hil.bench.outcome import RunOptions
from hil.bench.scenario import BusTable, Scenario, load_scenario
from hil.canbus.socketcan_rate import check_bitrate
from hil.canbus.transport import BusOptions, add_bus_arguments, default_options, options_from_namespace
from hil.cli.progress import Progress
from hil.cli.waiting import waiting_words
from hil.record.log_formats import check_formats
from hil.record.viewer import display_missing
from hil.record.web_viewer import WebViewer

DEFAULT_SCENARIO = "cat_linh_la_thanh"
MAX_PRIORITY = 88  # the hub runs ten above, and 99 belongs to the kernel


def run(
    scenario: Annotated[
        str, typer.Argument(help="A shipped scenario (hil list) or a TOML file.")
    ] = DEFAULT_SCENARIO,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="As fast as it goes, step by step; same seed, same frames.")
    ] = False,
    law: Annotated[str | None, typer.Option(help="Control law; short for --set controller.law=…")] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of all noise; short for --set journey.seed=…")
    ] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the scenario.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory of the results [runs/<time>-<scenario>].")
    ] = None,
    show_live: Annotated[bool, typer.Option("--view", help="Watch it live in the Rerun viewer.")] = False,
    web: Annotated[bool, typer.Option("--web", help="Watch it live in a browser.")] = False,
    interface: Annotated[str | None, typer.Option("-i", "--interface", help="python-can interface.")] = None,
    channel: Annotated[str | None, typer.Option("-c", "--channel", help="Channel of the bus.")] = None,
    bitrate: Annotated[int | None, typer.Option("-b", "--bitrate", help="Bit rate [bit/s].")] = None,
    fd: Annotated[bool, typer.Option("--fd", help="Open the bus for CAN FD.")] = False,
    bus_kwargs: Annotated[
        list[str] | None,
        typer.Option(
            "--bus-kwargs", metavar="KEY=VALUE", help="More options of the interface, as in python-can."
        ),
    ] = None,
    log: Annotated[
        list[str] | None,
        typer.Option(metavar="FORMAT", help="Frame log beside frames.blf: mf4, asc, log (candump) or trc."),
    ] = None,
    dbc: Annotated[Path | None, typer.Option(help="Another DBC with the bench's messages.")] = None,
    priority: Annotated[
        int, typer.Option(help="SCHED_FIFO priority of the controller, 1 to 88; 0: do not ask.")
    ] = 50,
    as_json: Annotated[bool, typer.Option("--json", help="Print summary.json and nothing else.")] = False,
) -> int:
    """Drive a train from station to station over CAN, record it, and judge it.

    [bold]hil run[/bold]                                   Cat Linh - La Thanh in real time

    [bold]hil run fuzzy_d_2km --law pid --lockstep[/bold]  another line and law, as fast as it goes

    [bold]hil run my.toml -i socketcan -c vcan0[/bold]     your scenario on a real bus

    [bold]hil run --web[/bold]                             watch it in a browser while it drives
    """
    check_priority(priority)
    console = Console(stderr=as_json)
    if show_live and not web and display_missing():
        console.print(
            "no live view: there is no display here; use --web, or afterwards hil view --web RUN",
            style="yellow",
        )
        show_live = False
    chosen = list(overrides or [])
    if law is not None:
        chosen.append(f"controller.law={json.dumps(law)}")
    if seed is not None:
        chosen.append(f"journey.seed={seed}")
    with tempfile.TemporaryDirectory(prefix="hil-") as scratch:
        loaded = load_scenario(scenario, chosen, scratch=Path(scratch))
    bus = bus_options(loaded, interface, channel, bitrate, fd, bus_kwargs or [])
    directory = new_run_directory(out, loaded.name)
    loaded.write(directory / "scenario.toml")
    options = RunOptions(
        scenario=loaded,
        out=directory,
        bus=bus,
        channel_is_given=channel is not None or loaded.bus.channel is not None,
        lockstep=lockstep,
        view=show_live and not web,
        priority=priority or None,
        dbc=dbc,
        logs=check_formats(log or ()),
    )
    _announce(console, options)
    # Only now: bad input is told before the recording library has been loaded.
    from hil.bench.run import exit_code, run_scenario

    with _web_viewer(console) if web else nullcontext() as viewer:
        if viewer is not None:
            options = replace(options, viewer_url=viewer.url)
        with Progress(loaded, console=console) as progress:
            summary = run_scenario(
                options,
                show=lambda view, speedup: progress.show(view, speedup=speedup),
                tell=lambda line: typer.echo(f"hil run: {line}", err=True),
            )
        _tell(console, summary, directory, as_json=as_json)
        if viewer is not None and sys.stdin.isatty():
            console.print(f"still to be seen at {viewer.address}   (Ctrl-C ends it)", soft_wrap=True)
            viewer.wait()
    return exit_code(summary)


def _web_viewer(console: Console) -> WebViewer:
    viewer = WebViewer()
    console.print(f"live: {viewer.address}", highlight=False, soft_wrap=True, markup=False)
    return viewer


def _tell(console: Console, summary: dict[str, Any], directory: Path, *, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(summary, indent=2))
    else:
        report(console, summary, directory)
    if summary["ended"] == "died":
        typer.echo(f"hil run: {summary['ended_because']}", err=True)
    _write_html(console, directory)


def check_priority(priority: int) -> None:
    """Raises ScenarioError for a SCHED_FIFO priority with which the hub could not be above the controller."""
    if not 0 <= priority <= MAX_PRIORITY:
        raise ScenarioError(f"--priority {priority}: must be 0 to {MAX_PRIORITY}")


def bus_options(
    scenario: Scenario | None,
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    fd: bool,
    bus_kwargs: list[str],
) -> BusOptions:
    """The bus: the command line wins over the scenario, the scenario over can.conf and defaults."""
    wanted = scenario.bus if scenario is not None else BusTable()
    interface = interface if interface is not None else wanted.interface
    channel = channel if channel is not None else wanted.channel
    bitrate = bitrate if bitrate is not None else wanted.bitrate
    if bitrate is not None and bitrate <= 0:
        raise ScenarioError(f"--bitrate {bitrate}: must be greater than 0 bit/s")
    data_bitrate = wanted.data_bitrate
    if data_bitrate is not None and not any(word.startswith("data_bitrate=") for word in bus_kwargs):
        bus_kwargs = [*bus_kwargs, f"data_bitrate={data_bitrate}"]
    if interface is None and channel is None and bitrate is None and not fd and not bus_kwargs:
        return default_options()
    arguments: list[str] = []
    for flag, value in (("-i", interface), ("-c", channel), ("-b", bitrate)):
        if value is not None:
            arguments += [flag, str(value)]
    if fd:
        arguments.append("--fd")
    if bus_kwargs:
        arguments += ["--bus-kwargs", *bus_kwargs]
    parser = _BusParser(prog="hil run", add_help=False)
    add_bus_arguments(parser)
    bus = options_from_namespace(parser.parse_args(arguments))
    check_bitrate(bus)
    return bus


class _BusParser(argparse.ArgumentParser):
    """python-can's bus options; an error is an exception of ours instead of a page of usage."""

    def error(self, message: str) -> NoReturn:
        raise ScenarioError(message)


def report(console: Console, summary: dict[str, Any], directory: Path) -> None:
    """Print the verdict table and where the results are."""
    table = Table("criterion", "value", "limit", "unit", "", box=None, pad_edge=False)
    for column in (1, 2):
        table.columns[column].justify = "right"
    for row in summary["criteria"]:
        value = "-" if row["value"] is None else f"{row['value']:.3f}".rstrip("0").rstrip(".")
        mark = "[green]passed[/green]" if row["passed"] else "[red]failed[/red]"
        table.add_row(row["name"], value, f"{row['limit']:g}", row["unit"], mark)
    console.print(table)
    _timing_lines(console, summary)
    colour = {"passed": "green", "failed": "red", "aborted": "yellow"}[summary["verdict"]]
    because = "" if summary["ended"] == "arrived" else f" ({summary['ended_because']})"
    speed = f", {summary['speedup']:.0f}x real time" if summary["mode"] == "lockstep" else ""
    console.print(f"\n[bold {colour}]{summary['verdict']}[/]{because}{speed}", highlight=False)
    console.print(
        f"recording: {directory / 'run.rrd'}   open it: hil view {directory}", highlight=False, soft_wrap=True
    )


def _write_html(console: Console, directory: Path) -> None:
    """report.html, after the verdict has been told: what goes wrong here takes nothing away from the run."""
    try:
        from hil.bench.report import write_report

        path = write_report(directory).path
    except (Exception, KeyboardInterrupt) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        typer.echo(f"hil run: no report.html: {reason} (again: hil report {directory})", err=True)
    else:
        console.print(f"report: {path}", highlight=False, soft_wrap=True, markup=False)


def _timing_lines(console: Console, summary: dict[str, Any]) -> None:
    if summary["mode"] == "lockstep":
        return
    for name, timing in summary["timing"].items():
        latency, execution = timing["wakeup_latency_us"], timing["execution_us"]
        fifo = (
            "SCHED_FIFO" if timing["sched_fifo"] else "no real-time rights (hil doctor says how to get them)"
        )
        console.print(
            f"[dim]{name}: {timing['cycles']} cycles, wake-up latency p50 {latency['p50']:.0f}"
            f" p99 {latency['p99']:.0f} max {latency['max']:.0f} us, execution p50 {execution['p50']:.0f}"
            f" p99 {execution['p99']:.0f} us, {fifo};"
            f" {waiting_words(timing['spin'], timing['rehearsal'])}[/dim]",
            highlight=False,
            soft_wrap=True,
        )


def _announce(console: Console, options: RunOptions) -> None:
    journey, bus = options.scenario.journey, options.bus
    where = "one process" if bus.interface == "virtual" else "separate processes"
    console.print(
        f"[bold]{options.scenario.name}[/bold]: {journey.origin.name} - {journey.destination.name},"
        f" {journey.distance_m:.0f} m in {journey.time_s:g} s, {options.scenario.law},"
        f" {1 / options.scenario.controller_period_s:.0f} Hz, {options.mode}, {where},"
        f" bus {bus.interface} {bus.channel}",
        highlight=False,
        soft_wrap=True,
    )
    console.print("[dim]starting (the very first start compiles: some seconds more)[/dim]", highlight=False)
    if bus.interface == "hil" and bus.bitrate is not None and options.lockstep:
        console.print(
            "lockstep: time is not the wall clock, so frames take no time on the wire:"
            f" {bus.bitrate} bit/s left out",
            style="yellow",
            soft_wrap=True,
        )
    if bus.interface == "virtual" and not options.lockstep:
        console.print(
            "both nodes share this process as threads: they take turns at the interpreter, so wake-up"
            " latency is milliseconds; for timing use separate processes (-i hil or -i socketcan)",
            style="yellow",
            soft_wrap=True,
        )
