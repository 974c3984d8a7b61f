"""`hil bus up`, `down`, `statistics`: the hub of a channel of the local bus."""

from __future__ import annotations

import json
import os
import signal
import time
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from hil.canbus.errors import BusOptionsError, BusUnavailable
from hil.canbus.local import address, link
from hil.canbus.local.client import DEFAULT_CHANNEL
from hil.canbus.local.rates import RESTART_MS, TX_QUEUE_FRAMES
from hil.canbus.local.wire import WireError
from hil.cli.bus_analyse import wide_console

DOWN_LIMIT_S = 5.0
HEADS = {
    "frames_sent": "frames",
    "retransmissions": "repeated",
    "backlog_bytes": "backlog",
    "unread_bytes": "unread",
}
ALWAYS_SHOWN = {"number", "name", "pid", "frames_sent"}

Channel = Annotated[str, typer.Option("-c", "--channel", help="Name of the channel.")]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]


def up(
    channel: Channel = DEFAULT_CHANNEL,
    bitrate: Annotated[
        int | None, typer.Option("-b", "--bitrate", help="Bit rate [bit/s]; default: as fast as it goes.")
    ] = None,
    data_bitrate: Annotated[
        int | None, typer.Option("--data-bitrate", help="Bit rate of CAN FD's data phase [bit/s].")
    ] = None,
    tx_queue: Annotated[
        int | None,
        typer.Option(
            "--tx-queue",
            metavar="FRAMES",
            help=f"With a bit rate: a sender is held when so many frames wait (default {TX_QUEUE_FRAMES}).",
        ),
    ] = None,
    restart_ms: Annotated[
        int | None,
        typer.Option(
            "--restart-ms",
            metavar="MS",
            help="With a bit rate: a node that went bus-off is back after so long, 0: never"
            f" (default {RESTART_MS}).",
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Start the hub of a local bus; it stays until [bold]hil bus down[/bold].

    Not needed for a run: who joins a channel without a hub starts one, which ends after the last one left.

    [bold]hil bus up -c ato[/bold]                   frames as fast as the machine

    [bold]hil bus up -c ato --bitrate 500000[/bold]  with the wire time of a real bus
    """
    for option, rate in (("--bitrate", bitrate), ("--data-bitrate", data_bitrate)):
        if rate is not None and rate <= 0:
            raise BusOptionsError(f"{option} {rate}: must be greater than 0 bit/s")
    for option, value, least in (("--tx-queue", tx_queue, 1), ("--restart-ms", restart_ms, 0)):
        if value is not None and value < least:
            raise BusOptionsError(f"{option} {value}: must be {least} or more")
    for option, value in (
        ("--data-bitrate", data_bitrate),
        ("--tx-queue", tx_queue),
        ("--restart-ms", restart_ms),
    ):
        if value is not None and bitrate is None:
            raise BusOptionsError(f"{option}: needs --bitrate as well")
    found = _query(channel)
    started = found is None
    if found is None:
        try:
            link.start_hub(
                channel,
                bitrate=bitrate,
                data_bitrate=data_bitrate,
                tx_queue_frames=tx_queue,
                restart_ms=restart_ms,
                linger_s=None,
            )
        except link.JoinError as error:
            raise BusUnavailable(str(error)) from None
        found = _query_soon(channel)
    else:
        _refuse_another(channel, found, bitrate, data_bitrate, tx_queue, restart_ms)
    if as_json:
        typer.echo(json.dumps({"channel": channel, "started": started, "pid": found["pid"]}))
    else:
        what = "is up" if started else "was up already"
        typer.echo(
            f"channel '{channel}' {what}, process {found['pid']}; join it with -i hil -c {channel},"
            f" watch it with: hil bus dump -i hil -c {channel}"
        )
    return 0


def down(channel: Channel = DEFAULT_CHANNEL, as_json: AsJson = False) -> int:
    """Stop the hub of a local bus; whoever is on it is told so.

    [bold]hil bus down -c ato[/bold]
    """
    found = _query(channel)
    if found is not None:
        os.kill(int(found["pid"]), signal.SIGTERM)
        deadline_s = time.monotonic() + DOWN_LIMIT_S
        while channel in address.channels():
            if time.monotonic() > deadline_s:
                raise BusUnavailable(
                    f"channel '{channel}': its hub, process {found['pid']}, did not end in {DOWN_LIMIT_S:g} s"
                )
            time.sleep(0.02)
    if as_json:
        typer.echo(json.dumps({"channel": channel, "stopped": found is not None}))
    elif found is None:
        others = ", ".join(address.channels())
        typer.echo(f"channel '{channel}' has no hub" + (f"; there are: {others}" if others else ""))
    else:
        typer.echo(f"channel '{channel}' is down")
    return 0


def statistics(
    channel: Annotated[
        str | None, typer.Option("-c", "--channel", help="Name of the channel; default: all that are up.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Say what the hubs of local buses know: clients, frames, backlogs, who was removed and why.

    [bold]hil bus statistics[/bold]         every hub of this user

    [bold]hil bus statistics -c ato[/bold]  one of them
    """
    names = address.channels() if channel is None else [channel]
    found = [hub for hub in map(_query, names) if hub is not None]
    if channel is not None and not found:
        raise BusUnavailable(f"channel '{channel}' has no hub; 'hil bus up -c {channel}' starts one")
    if as_json:
        typer.echo(json.dumps(found, indent=2))
        return 0
    console = wide_console()
    if not found:
        console.print("no local bus is up")
    for hub in found:
        _report(console, hub)
    return 0


def _refuse_another(
    channel: str,
    found: dict[str, Any],
    bitrate: int | None,
    data_bitrate: int | None,
    tx_queue: int | None,
    restart_ms: int | None,
) -> None:
    """BusOptionsError when the hub that is up has not, or may not have, what is asked for."""
    has = found.get("bitrate")
    first = f": 'hil bus down -c {channel}' first"
    if bitrate is not None and bitrate != has:
        raise BusOptionsError(f"channel '{channel}' has a hub already, with bit rate {has}{first}")
    if data_bitrate is not None and data_bitrate != found.get("data_bitrate"):
        raise BusOptionsError(
            f"channel '{channel}' has a hub already, with data bit rate {found.get('data_bitrate')}{first}"
        )
    for option, value in (("--tx-queue", tx_queue), ("--restart-ms", restart_ms)):
        if value is not None:
            raise BusOptionsError(
                f"channel '{channel}' has a hub already; {option} is for one that starts{first}"
            )


def _report(console: Console, hub: dict[str, Any]) -> None:
    rate = "no bit rate" if hub.get("bitrate") is None else f"{hub['bitrate']} bit/s"
    console.print(
        f"[bold]{hub['channel']}[/bold]: process {hub['pid']}, {rate}, up {hub['uptime_s']:.1f} s,"
        f" {hub['frames']} frames, backlog {hub['backlog_bytes']} bytes",
        highlight=False,
    )
    shown = {"channel", "pid", "bitrate", "uptime_s", "frames", "backlog_bytes", "clients", "removed"}
    for key, value in hub.items():
        if key not in shown and isinstance(value, int | float | str):
            console.print(f"  {key} {value}", highlight=False, style="dim")
    if hub["clients"]:
        # Of the counters only those that say something.
        columns = [
            name
            for name in hub["clients"][0]
            if name in ALWAYS_SHOWN or any(client.get(name) for client in hub["clients"])
        ]
        heads = [HEADS.get(name, name) for name in columns]
        table = Table(*heads, box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
        for client in hub["clients"]:
            table.add_row(*(str(client.get(column, "")) for column in columns))
        console.print(table, highlight=False)
    for gone in hub["removed"]:
        console.print(f"  [yellow]client {gone['number']} {gone['reason']}[/yellow]", highlight=False)


def _query(channel: str) -> dict[str, Any] | None:
    """What the hub of a channel says; None: there is none."""
    try:
        return link.query(channel)
    except address.AddressError as error:
        raise BusOptionsError(str(error)) from None
    except address.NoHubError:
        return None
    except (OSError, WireError) as error:
        raise BusUnavailable(
            f"the hub of channel '{channel}' does not answer: {' '.join(str(error).split())}"
        ) from None


def _query_soon(channel: str) -> dict[str, Any]:
    """The same of a hub that is about to listen."""
    deadline_s = time.monotonic() + link.JOIN_LIMIT_S
    while time.monotonic() < deadline_s:
        found = _query(channel)
        if found is not None:
            return found
        time.sleep(0.02)
    raise BusUnavailable(f"channel '{channel}': its hub was started but does not listen")
