"""`hil bus`: what the CAN bus can carry, what it carries, and the local bus's hub. One file per command."""

from __future__ import annotations

import typer

from hil.cli.bus_analyse import analyse
from hil.cli.bus_dump import dump
from hil.cli.bus_hub import down, statistics, up
from hil.cli.bus_load import load

bus = typer.Typer(
    help="The CAN bus: response-time analysis, measured load, decoded traffic, and the local bus.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
for function in (analyse, load, dump, up, down, statistics):
    bus.command()(function)
