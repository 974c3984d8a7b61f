"""`hil bus analyse`: can every message meet its deadline, computed from the DBC."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

import dbc as shipped
from hil.canbus.analysis.message_set import NS_PER_MS, MessageSet, MessageSetError, Reading, message_set
from hil.canbus.analysis.queues import BENCH_TOGETHER, Queues, groups_of
from hil.canbus.analysis.response_time import FaultHypothesis
from hil.canbus.analysis.schedulability import Analysis, Verdict, Wire
from hil.canbus.analysis.schedulability import analyse as analyse_set

PICTURE = "bus-analysis.png"
WIDE = 130
NARROW = 112
"""Below this many characters only the columns that decide are shown."""
MAX_CLASSIC_BITRATE = 1_000_000
COLUMNS = (
    "id",
    "message",
    "sender",
    "cycle\nms",
    "bytes",
    "C\nms",
    "load\n%",
    "bound R\nms",
    "deadline\nms",
    "slack\nms",
    "verdict",
)
LEFT_OUT_IF_NARROW = {"sender", "bytes", "C\nms", "load\n%", "slack\nms"}
METHOD = (
    "Davis, Burns, Bril, Lukkien, Controller Area Network (CAN) schedulability analysis: Refuted, revisited"
    " and revised, Real-Time Systems 35 (2007)"
)
METHOD_FIFO = (
    "Davis, Kollmann, Pollex, Slomka, Schedulability analysis for Controller Area Network (CAN) with FIFO"
    " queues, priority queues and gateways, Real-Time Systems 49 (2013)"
)


class QueueChoice(StrEnum):
    """What `--queue` may say."""

    AUTO = "auto"
    FIFO = "fifo"
    PRIORITY = "priority"


def analyse(
    bitrate: Annotated[int, typer.Option("-b", "--bitrate", help="Nominal bit rate [bit/s].")] = 250_000,
    data_bitrate: Annotated[
        int | None,
        typer.Option("--data-bitrate", help="Bit rate of the data phase; all frames are CAN FD then."),
    ] = None,
    fd: Annotated[bool, typer.Option("--fd", help="All frames are CAN FD.")] = False,
    dbc: Annotated[Path | None, typer.Option("--dbc", help="Your DBC; default: the bench's.")] = None,
    jitter: Annotated[
        float, typer.Option("--jitter", metavar="MS", help="How late a sender may queue a frame [ms].")
    ] = 0.0,
    cycle: Annotated[
        list[str] | None,
        typer.Option("--cycle", metavar="MESSAGE=MS", help="Another cycle than the DBC's; may be repeated."),
    ] = None,
    event_interval: Annotated[
        float | None,
        typer.Option(
            "--event-interval",
            metavar="MS",
            help="Shortest time between two frames of an event; default: its sender's shortest cycle.",
        ),
    ] = None,
    silence: Annotated[
        bool, typer.Option("--silence", help="Deadlines are the silence limits (TimeoutMs), not the cycles.")
    ] = False,
    queue: Annotated[
        QueueChoice,
        typer.Option(
            "--queue",
            help="What a node offers first: fifo, what it queued first; priority, its most urgent frame;"
            " auto: fifo, but what TransmitQueue of the DBC says of a node.",
        ),
    ] = QueueChoice.AUTO,
    together: Annotated[
        list[str] | None,
        typer.Option(
            "--together",
            metavar="NODE,NODE",
            help="Nodes that share one fifo; may be repeated; 'none': each has its own. Default for the"
            f" bench's DBC: {' '.join(','.join(group) for group in BENCH_TOGETHER)}.",
        ),
    ] = None,
    error_interval: Annotated[
        float | None,
        typer.Option("--error-interval", metavar="MS", help="Disturbances: one error in so many ms at most."),
    ] = None,
    error_burst: Annotated[
        int, typer.Option("--error-burst", metavar="N", help="... and so many at once at first.")
    ] = 1,
    out: Annotated[
        Path | None, typer.Option("--out", help=f"A picture: a .png file, or a directory for {PICTURE}.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> int:
    """Compute from the DBC how late every message can be, and from which bit rate on all are in time.

    [bold]hil bus analyse --bitrate 125000[/bold]            the bench's messages

    [bold]hil bus analyse --dbc my.dbc --jitter 1[/bold]     yours, queued up to 1 ms late

    Exit code 0: no message can miss its deadline; 1: some can; 2: bad input.
    """
    wire = wire_of(bitrate, data_bitrate)
    reading = Reading(
        jitter_ns=_ns("--jitter", jitter, zero=True),
        event_interval_ns=None if event_interval is None else _ns("--event-interval", event_interval),
        silence=silence,
        cycles_ns=dict(_cycle(text) for text in cycle or []),
        fd=fd or data_bitrate is not None,
    )
    faults = None
    if error_burst < 1:
        raise MessageSetError(f"--error-burst {error_burst}: at least 1")
    if error_interval is not None:
        faults = FaultHypothesis(_ns("--error-interval", error_interval), error_burst)
    elif error_burst != 1:
        raise MessageSetError("--error-burst: needs --error-interval MS as well")
    messages = message_set(dbc, reading)
    found = analyse_set(messages, wire, faults, queues_of(queue, together, bench=_is_the_benchs(dbc)))
    picture = None
    if out is not None:
        from hil.cli.bus_picture import draw_bounds

        picture = out if out.suffix == ".png" else out / PICTURE
        try:
            picture.parent.mkdir(parents=True, exist_ok=True)
            draw_bounds(found, picture)
        except OSError as error:
            raise MessageSetError(f"--out {out}: cannot be written: {error.strerror}") from None
    if as_json:
        typer.echo(json.dumps(document(found, reading), indent=2))
    else:
        report(wide_console(), found, reading)
        if picture is not None:
            Console().print(f"\npicture: {picture}", highlight=False, soft_wrap=True)
    return 0 if found.meets else 1


def queues_of(queue: QueueChoice, together: list[str] | None, *, bench: bool) -> Queues:
    """The transmit queues that the options ask for; MessageSetError: they contradict each other."""
    if queue is QueueChoice.PRIORITY:
        if together:
            raise MessageSetError("--together: with --queue priority no node has a queue to share")
        return Queues("priority")
    groups = groups_of(together) if together is not None else BENCH_TOGETHER if bench else ()
    return Queues("fifo" if queue is QueueChoice.FIFO else "auto", groups)


def _is_the_benchs(dbc: Path | None) -> bool:
    return dbc is None or dbc.resolve() == Path(shipped.path()).resolve()


def wide_console() -> Console:
    """A console; where there is no terminal (a pipe, a file), lines are not cut."""
    console = Console()
    return console if console.is_terminal else Console(width=max(console.width, WIDE))


def report(console: Console, found: Analysis, reading: Reading) -> None:
    """Print the table, the assumptions, and what the numbers say."""
    console.print(_title(found), highlight=False)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    shown = [head for head in COLUMNS if console.width >= NARROW or head not in LEFT_OUT_IF_NARROW]
    for head in shown:
        right = head not in ("id", "message", "sender", "verdict")
        table.add_column(head, justify="right" if right else "left", no_wrap=True)
    for verdict in found.verdicts:
        cells = dict(zip(COLUMNS, _row(verdict), strict=True))
        table.add_row(*(cells[head] for head in shown))
    console.print(table, highlight=False)
    _say_loads(console, found)
    _say_verdict(console, found)
    _say_assumptions(console, found.messages, reading, found)


def document(found: Analysis, reading: Reading) -> dict[str, Any]:
    """The analysis as JSON: times in ms, loads as fractions of the bus, bit rates in bit/s."""
    return {
        "method": METHOD if found.queues.kind == "priority" else METHOD_FIFO,
        "queue": found.queues.kind,
        "together": [list(group) for group in found.queues.together],
        "dbc": found.messages.source,
        "bitrate": found.wire.bitrate,
        "data_bitrate": found.wire.data_bitrate,
        "deadlines": "silence" if reading.silence else "cycle",
        "error_interval_ms": None if found.faults is None else found.faults.interval_ns / NS_PER_MS,
        "error_burst": None if found.faults is None else found.faults.burst,
        "meets": found.meets,
        "worst_load": found.worst_load,
        "best_load": found.best_load,
        "needs_bitrate": found.needs_bitrate,
        "threshold_bitrate": found.threshold_bitrate,
        "breakdown_load": found.breakdown_load,
        "messages": [
            _message_document(verdict, queue)
            for verdict, queue in zip(found.verdicts, found.queues.of(found.messages), strict=True)
        ],
        "emptied_each_cycle": found.emptied_each_cycle,
        "left_out": dict(found.messages.left_out),
    }


def _message_document(verdict: Verdict, queue: str | None) -> dict[str, Any]:
    message, bound = verdict.message, verdict.bound
    return {
        "name": message.name,
        "id": message.can_id,
        "extended": message.extended,
        "sender": message.sender,
        "queue": queue,
        "fd": message.fd,
        "length": message.length,
        "event": message.event,
        "period_ms": message.period_ns / NS_PER_MS,
        "assumption": message.assumption or None,
        "jitter_ms": message.jitter_ns / NS_PER_MS,
        "transmission_ms": bound.stream.transmission_ns / NS_PER_MS,
        "buffering_ms": _milliseconds(bound.buffering_ns),
        "blocking_ms": bound.blocking_ns / NS_PER_MS,
        "busy_period_ms": _milliseconds(bound.busy_period_ns),
        "instance": bound.instance,
        "instances": bound.instances,
        "bound_ms": _milliseconds(bound.response_ns),
        "deadline_ms": message.deadline_ns / NS_PER_MS,
        "silence_ms": _milliseconds(message.silence_ns),
        "slack_ms": _milliseconds(bound.slack_ns),
        "meets": bound.meets,
        "worst_load": verdict.worst_load,
        "best_load": verdict.best_load,
        "needs_bitrate": verdict.needs_bitrate,
    }


def _title(found: Analysis) -> str:
    rate = f"{kbit(found.wire.bitrate)} kbit/s"
    if found.wire.data_bitrate is not None:
        rate += f", data {kbit(found.wire.data_bitrate)} kbit/s"
    count = len(found.verdicts)
    queue = "mailboxes" if found.queues.kind == "priority" else "first-in first-out queues"
    return (
        f"[bold]{found.messages.source}[/bold] at [bold]{rate}[/bold], {count} messages\n"
        f"{queue}; most urgent message first\n"
    )


def _row(verdict: Verdict) -> list[str]:
    message, bound = verdict.message, verdict.bound
    period = f"{message.period_ns / NS_PER_MS:g}"
    needs = "no usual rate" if verdict.needs_bitrate is None else f"{kbit(verdict.needs_bitrate)} kbit/s"
    colour = "green" if bound.meets else "red"
    return [
        f"0x{message.can_id:0{8 if message.extended else 3}X}",
        f"[bold]{message.name}[/bold]",
        message.sender or "-",
        f"[yellow]>= {period} *[/yellow]"
        if message.assumption
        else f">= {period}"
        if message.event
        else period,
        str(message.length),
        f"{bound.stream.transmission_ns / NS_PER_MS:.3f}",
        f"{100.0 * verdict.worst_load:.2f}",
        "none" if bound.response_ns is None else f"[{colour}]{bound.response_ns / NS_PER_MS:.3f}[/{colour}]",
        f"{message.deadline_ns / NS_PER_MS:g}",
        "-" if bound.slack_ns is None else f"{bound.slack_ns / NS_PER_MS:.3f}",
        "[green]meets[/green]" if bound.meets else f"[bold red]CAN MISS[/bold red] (from {needs})",
    ]


def _say_loads(console: Console, found: Analysis) -> None:
    console.print(
        f"\nload at worst [bold]{found.worst_load:.1%}[/bold] (all stuff bits),"
        f" at best {found.best_load:.1%} (none)",
        highlight=False,
    )


def _say_verdict(console: Console, found: Analysis) -> None:
    late = [verdict.message.name for verdict in found.verdicts if not verdict.bound.meets]
    if late:
        console.print(f"[bold red]can miss their deadlines:[/bold red] {', '.join(late)}", highlight=False)
    else:
        console.print("[bold green]no message can miss its deadline[/bold green]", highlight=False)
    if found.threshold_bitrate is None:
        console.print("there is no bit rate at which all meet their deadlines", highlight=False)
        return
    usual = "above 1 Mbit/s" if found.needs_bitrate is None else f"{kbit(found.needs_bitrate)} kbit/s"
    console.print(
        f"all meet from [bold]{found.threshold_bitrate / 1e3:.3f} kbit/s[/bold] on, lowest usual rate"
        f" [bold]{usual}[/bold]; the load at worst would be {found.breakdown_load:.1%} there (breakdown"
        " utilisation)",
        highlight=False,
    )


def _say_assumptions(console: Console, messages: MessageSet, reading: Reading, found: Analysis) -> None:
    lines = [f"* {m.name}: event, {m.assumption}" for m in messages.messages if m.assumption]
    whose = "the silence limit where there is one" if reading.silence else "the cycle"
    lines.append(f"deadline: {whose}; sender's queueing jitter {reading.jitter_ns / NS_PER_MS:g} ms")
    lines += found.queues.describe(messages)
    if found.queues.kind != "priority":
        lines.append("--queue priority: the bounds of nodes with a mailbox per message")
    if found.emptied_each_cycle:
        lines.append("  and of nodes that queue once per cycle, most urgent first (as hil.node)")
    if found.faults is None:
        lines.append("no transmission errors (--error-interval MS takes them in)")
    else:
        lines.append(
            f"errors: {found.faults.burst} at once, then one in {found.faults.interval_ns / NS_PER_MS:g} ms"
        )
    lines += [f"left out: {name}, {why}" for name, why in messages.left_out.items()]
    console.print("\n[dim]assumed:[/dim]", highlight=False)
    for line in lines:
        console.print(f"[dim]  {line}[/dim]", highlight=False, soft_wrap=True)


def kbit(bitrate: int) -> str:
    """A bit rate in kbit/s, as people write it: 83.3, 125, 500."""
    return f"{bitrate / 1000:.4g}" if bitrate < 10_000_000 else f"{bitrate / 1000:.0f}"


def wire_of(bitrate: int, data_bitrate: int | None) -> Wire:
    """The wire that the options ask for; MessageSetError when CAN has no such bit rate."""
    if not 0 < bitrate <= MAX_CLASSIC_BITRATE:
        raise MessageSetError(f"--bitrate {bitrate}: must be 1 to {MAX_CLASSIC_BITRATE} bit/s")
    if data_bitrate is not None and not bitrate <= data_bitrate <= 20 * MAX_CLASSIC_BITRATE:
        raise MessageSetError(
            f"--data-bitrate {data_bitrate}: must be from the nominal bit rate {bitrate} to"
            f" {20 * MAX_CLASSIC_BITRATE} bit/s"
        )
    return Wire(bitrate, data_bitrate)


def _cycle(text: str) -> tuple[str, int]:
    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        raise MessageSetError(f"--cycle {text}: write it as MESSAGE=MS, e.g. ATO_Command=1") from None
    return name, _ns(f"--cycle {name}", number)


def _ns(option: str, value_ms: float, *, zero: bool = False) -> int:
    """An option in ms as ns; MessageSetError when it cannot be a time."""
    if not (0.0 <= value_ms <= 1e6) or (value_ms * NS_PER_MS < 1 and not (zero and value_ms == 0.0)):
        least = "0" if zero else "above 0"
        raise MessageSetError(f"{option} {value_ms:g}: must be {least} to 1000000 ms")
    return round(value_ms * NS_PER_MS)


def _milliseconds(time_ns: int | None) -> float | None:
    return None if time_ns is None else time_ns / NS_PER_MS
