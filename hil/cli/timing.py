"""`hil timing`: validates this host; the bench's loop and the whole bench beside cyclictest; a verdict."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from hil.bench.directory import new_run_directory
from hil.bench.errors import ScenarioError
from hil.bench.scenario import load_scenario
from hil.bench.timing.request import (
    FULL,
    FULL_ALONE,
    LOOP_PLAIN,
    LOOP_SPIN,
    PEER,
    TimingRequest,
    check,
    default_slices,
)
from hil.cli.run import DEFAULT_SCENARIO, bus_options, check_priority

if TYPE_CHECKING:
    from hil.bench.timing.campaign import Campaign
    from hil.bench.timing.limits import TimingLimits

LONG_SCENARIO = "mainline_36km"
LONG_S = 80.0
"""Slices that are longer need a journey that is longer than the default one."""


def timing(
    period: Annotated[float, typer.Option(help="Period of loop, nodes and cyclictest [s].")] = 0.01,
    duration: Annotated[float, typer.Option(help="Measured time of each part [s].")] = 60.0,
    load: Annotated[bool, typer.Option("--load", help="Repeat everything with every core busy.")] = False,
    cpu: Annotated[
        int | None,
        typer.Option(help="CPU for loop, controller and cyclictest [controller's own]."),
    ] = None,
    priority: Annotated[int, typer.Option(help="SCHED_FIFO priority, 1 to 88; 0: SCHED_OTHER for all.")] = 50,
    spin: Annotated[
        str | None,
        typer.Option(help="How long to poll the clock before a deadline: auto, 0, or us [the scenario's]."),
    ] = None,
    limits: Annotated[Path | None, typer.Option(help="TOML file of limits [those shipped].")] = None,
    slices: Annotated[int | None, typer.Option(help="Slices of each part [none longer than 10 s].")] = None,
    witness: Annotated[
        bool, typer.Option("--witness", help="Only the whole bench, in one run, with cyclictest as witness.")
    ] = False,
    compare_recorder: Annotated[
        bool, typer.Option("--compare-recorder", help="The whole bench also without its recorder.")
    ] = False,
    scenario: Annotated[
        str | None,
        typer.Option(help=f"What the bench drives [{DEFAULT_SCENARIO}; {LONG_SCENARIO}]."),
    ] = None,
    interface: Annotated[str | None, typer.Option("-i", "--interface", help="python-can interface.")] = None,
    channel: Annotated[str | None, typer.Option("-c", "--channel", help="Channel of the bus.")] = None,
    bitrate: Annotated[int | None, typer.Option("-b", "--bitrate", help="Bit rate [bit/s].")] = None,
    fd: Annotated[bool, typer.Option("--fd", help="Open the bus for CAN FD.")] = False,
    out: Annotated[Path | None, typer.Option(help="Directory of the results [runs/<time>-timing].")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print timing.json and nothing else.")] = False,
) -> int:
    """Say how exact the bench is on this machine, beside cyclictest, and what costs it most.

    [bold]hil timing[/bold]                                   10 ms, one minute of each part

    [bold]hil timing --period 0.001 --load[/bold]             1 ms, then again with every core busy

    [bold]hil timing --witness --duration 600 --period 0.001[/bold]   is every miss explained?
    """
    check(period, duration, slices, spin or "auto")
    check_priority(priority)
    _check_cpu(cpu)
    if witness and load:
        raise ScenarioError("--witness --load: one or the other; start the load yourself to witness it")
    from hil.bench.timing.limits import load_limits

    wanted = load_limits(limits)
    pieces = slices or (1 if witness else default_slices(duration))
    name = scenario or (LONG_SCENARIO if duration / pieces > LONG_S else DEFAULT_SCENARIO)
    overrides = [f"controller.period_s={period!r}", f"plant.period_s={period!r}"]
    with tempfile.TemporaryDirectory(prefix="hil-") as scratch:
        loaded = load_scenario(name, overrides, scratch=Path(scratch))
    if cpu is None:
        from hil.bench.placement import place

        cpu = place(loaded.timing.controller_cpu, priority).controller
    spin = spin or str(loaded.timing.spin_us)
    bus = bus_options(loaded, interface, channel, bitrate, fd, [])
    if bus.interface == "virtual":
        raise ScenarioError(
            "-i virtual: both nodes would share one process and its interpreter, which is no timing to judge;"
            " use -i hil or -i socketcan"
        )
    if bus.interface == "hil" and channel is None:
        bus = replace(bus, channel=f"timing-{os.getpid()}")  # a hub of its own, whoever else drives here
    parts = (FULL,) if witness else _parts(spin, compare_recorder)
    request = TimingRequest(
        scenario=loaded, bus=bus, out=new_run_directory(out, "timing"), period_s=period, duration_s=duration,
        slices=pieces, parts=parts, priority=priority, cpu=cpu, spin=spin, load=load,
    )  # fmt: skip
    return _measure(request, wanted, as_json=as_json)


def _measure(request: TimingRequest, limits: TimingLimits, *, as_json: bool) -> int:
    """Measure, judge, write and show."""
    # Only now: bad input is told before the large libraries are loaded.
    from hil.bench.run import counted_interrupts
    from hil.bench.timing.advice import advice
    from hil.bench.timing.campaign import measure, seconds_needed
    from hil.bench.timing.document import as_document
    from hil.bench.timing.limits import judge, verdict
    from hil.canbus.contract import Contract
    from hil.cli.timing_progress import TimingProgress
    from hil.cli.timing_report import announce, report

    console = Console(stderr=as_json)
    announce(console, request, seconds_needed(request))
    started = datetime.now(UTC)
    with counted_interrupts() as interrupted, TimingProgress(console, seconds_needed(request)) as progress:
        campaign = measure(request, Contract.load(None), show=progress.show, interrupted=interrupted)
    rows = judge(limits, campaign.measured)
    found = advice(
        campaign.host, campaign.measured, campaign.steal_share, fifo=campaign.fifo,
        priority=request.priority, competitors=campaign.competitors,
    )  # fmt: skip
    document = as_document(
        campaign, rows, found, started=started, ended=datetime.now(UTC), command=["hil", *sys.argv[1:]]
    )
    files = _write(campaign, limits, document)
    if as_json:
        typer.echo(json.dumps(document, indent=2))
    else:
        report(console, campaign, rows, found, files)
    return 1 if verdict(rows) == "failed" else 0


def _write(campaign: Campaign, limits: TimingLimits, document: dict[str, Any]) -> list[Path]:
    """timing.json, timing.png and timing.rrd in the directory of the results."""
    from hil.bench.timing.picture import draw
    from hil.bench.timing.recording import record
    from hil.cli.timing_report import markdown

    folder = campaign.request.out
    file = folder / "timing.json"
    file.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return [file, draw(campaign, limits, folder), record(campaign, folder, markdown(campaign))]


def _parts(spin: str, compare_recorder: bool) -> tuple[str, ...]:
    parts = [LOOP_PLAIN, LOOP_SPIN, FULL, FULL_ALONE, PEER]
    if spin != "auto" and float(spin) == 0.0:
        parts.remove(LOOP_SPIN)  # the two loops would be one
    if not compare_recorder:
        parts.remove(FULL_ALONE)
    return tuple(parts)


def _check_cpu(cpu: int | None) -> None:
    if cpu is None:
        return
    from hil.bench.placement import may_use, usable_cpus

    if not may_use(cpu):
        raise ScenarioError(f"--cpu {cpu}: this process may use {', '.join(map(str, usable_cpus()))}")
