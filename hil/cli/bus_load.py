"""`hil bus load`: what is on the bus, per message and in the worst moment; live, or from a recording."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import can
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from hil.canbus.analysis.load import NS_PER_S, LoadMeter, MessageLoad, WireFrame
from hil.canbus.analysis.message_set import MessageSetError
from hil.canbus.contract import Contract
from hil.canbus.local import address, link
from hil.canbus.local.wire import WireError
from hil.canbus.options import LOCAL_INTERFACE, BusOptions
from hil.cli.bus_analyse import kbit, wide_console, wire_of
from hil.cli.bus_live import live_options, messages, open_live

LOG_OF_RUN = "frames.blf"
DEFAULT_BITRATE = 250_000


class LogError(ValueError):
    """A log cannot be read, or holds no frames: which file, why, what would be right."""

    exit_code = 2


def load(
    log: Annotated[
        Path | None, typer.Argument(help="A run directory or a log (.blf, .asc, .log, .trc …); else live.")
    ] = None,
    bitrate: Annotated[
        int | None,
        typer.Option(
            "-b", "--bitrate", help="Nominal bit rate [bit/s]; default: the run's or the hub's, else 250000."
        ),
    ] = None,
    data_bitrate: Annotated[
        int | None, typer.Option("--data-bitrate", help="Bit rate of the data phase of CAN FD.")
    ] = None,
    interface: Annotated[str | None, typer.Option("-i", "--interface", help="python-can interface.")] = None,
    channel: Annotated[str | None, typer.Option("-c", "--channel", help="Channel of the bus.")] = None,
    fd: Annotated[bool, typer.Option("--fd", help="Open the bus for CAN FD.")] = False,
    seconds: Annotated[float, typer.Option("--seconds", help="How long to listen.")] = 10.0,
    dbc: Annotated[Path | None, typer.Option("--dbc", help="Your DBC; default: the bench's.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> int:
    """Measure the bus load per message: how often, how many bits, which share of the bus.

    [bold]hil bus load -c ato --seconds 5[/bold]        listen to a bus that is there

    [bold]hil bus load runs/… --bitrate 125000[/bold]   what a run's frames would be at another bit rate
    """
    names = {(m.can_id, m.extended): m.name for m in Contract.load(dbc).messages.values()}
    if log is not None:
        path = log / LOG_OF_RUN if log.is_dir() else log
        rate = bitrate if bitrate is not None else _bitrate_of_run(path.parent)
        wire = wire_of(rate or DEFAULT_BITRATE, data_bitrate)
        meter = LoadMeter(wire.bitrate, wire.data_bitrate)
        _from_log(meter, path)
        span_ns, source = meter.span_ns, str(log)
    else:
        options = live_options(interface, channel, bitrate, fd=fd, data_bitrate=data_bitrate)
        wire = wire_of(bitrate or _bitrate_of_hub(options) or DEFAULT_BITRATE, data_bitrate)
        if not 0.0 < seconds <= 86_400.0:
            raise MessageSetError(f"--seconds {seconds:g}: must be above 0 and at most 86400")
        meter = LoadMeter(wire.bitrate, wire.data_bitrate)
        span_ns = _from_bus(meter, open_live(options, "hil bus load"), seconds)
        source = str(options)
    found = document(meter, span_ns, names, source)
    if as_json:
        typer.echo(json.dumps(found, indent=2))
    else:
        report(wide_console(), found)
    return 0


def document(
    meter: LoadMeter, span_ns: int, names: Mapping[tuple[int, bool], str], source: str
) -> dict[str, Any]:
    """The measured load as JSON: loads as fractions of the bus, rates per second."""
    seconds = span_ns / NS_PER_S

    def per_second(number: float) -> float | None:
        return number / seconds if seconds > 0.0 else None

    def row(message: MessageLoad) -> dict[str, Any]:
        return {
            "id": message.can_id,
            "extended": message.extended,
            "name": names.get((message.can_id, message.extended)),
            "frames": message.frames,
            "frames_per_s": per_second(message.frames),
            "bits_per_s": per_second(message.bits),
            "bits_per_frame": message.bits / message.frames,
            "load": message.wire_ns / span_ns if span_ns else None,
        }

    total = meter.wire_ns / span_ns if span_ns else None
    first_ns = meter.first_ns or 0
    return {
        "source": source,
        "bitrate": meter.bitrate,
        "data_bitrate": meter.data_bitrate,
        "seconds": seconds,
        "frames": meter.frames,
        "frames_per_s": per_second(meter.frames),
        "bits_per_s": per_second(sum(message.bits for message in meter.messages.values())),
        "error_frames": meter.errors,
        "load": total,
        "idle": None if total is None else max(0.0, 1.0 - total),
        "bursts": [
            {
                "window_ms": window.length_ns / 1e6,
                "load": window.load,
                "at_s": max(0, window.end_ns - window.length_ns - first_ns) / NS_PER_S,
            }
            for window in meter.windows
        ],
        "messages": [row(message) for message in meter.by_load()],
    }


def report(console: Console, found: Mapping[str, Any]) -> None:
    """Print the loads, the largest first."""
    rate = f"{kbit(found['bitrate'])} kbit/s"
    if found["data_bitrate"] is not None:
        rate += f", data {kbit(found['data_bitrate'])} kbit/s"
    console.print(
        f"[bold]{found['source']}[/bold]: {found['frames']} frames in {found['seconds']:.3f} s, counted at"
        f" [bold]{rate}[/bold]\n",
        highlight=False,
        soft_wrap=True,
    )
    if not found["frames"] or found["load"] is None:
        console.print("too few frames to speak of a load", highlight=False)
        return
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    table.add_column("id")
    table.add_column("message")
    for head in ("frames", "frames/s", "bits/frame", "bits/s", "load %"):
        table.add_column(head, justify="right")
    table.add_column("")
    largest = max(row["load"] for row in found["messages"]) or 1.0
    for row in found["messages"]:
        table.add_row(
            f"0x{row['id']:0{8 if row['extended'] else 3}X}",
            f"[bold]{row['name']}[/bold]" if row["name"] else "[dim]not in the DBC[/dim]",
            str(row["frames"]),
            f"{row['frames_per_s']:.2f}",
            f"{row['bits_per_frame']:.1f}",
            f"{row['bits_per_s']:.0f}",
            f"{100.0 * row['load']:.2f}",
            f"[cyan]{'█' * round(20 * row['load'] / largest)}[/cyan]",
        )
    console.print(table, highlight=False)
    over = " [red](more than the wire carries: a log without wire time)[/red]"
    console.print(
        f"\nload [bold]{found['load']:.2%}[/bold], idle {found['idle']:.2%},"
        f" {found['frames_per_s']:.1f} frames/s, {found['bits_per_s']:.0f} bit/s"
        + (f", {found['error_frames']} error frames" if found["error_frames"] else ""),
        highlight=False,
    )
    for burst in found["bursts"]:
        console.print(
            f"largest in {burst['window_ms']:g} ms: {burst['load']:.1%} at {burst['at_s']:.3f} s"
            + (over if burst["load"] > 1.0 else ""),
            highlight=False,
        )


def _from_log(meter: LoadMeter, path: Path) -> None:
    if not path.is_file():
        raise LogError(f"{path}: no such log (expected a run directory with {LOG_OF_RUN}, or a log file)")
    try:
        with can.LogReader(path) as reader, _progress(path, reader) as told:
            _count(meter, told)
    except Exception as error:  # readers of files from outside also end in struct.error, KeyError and others
        raise unreadable(path, error) from None
    if not meter.frames:
        raise LogError(
            f"{path}: holds no frames (a run in lockstep writes none there: nothing was on a wire)"
        )


def unreadable(path: Path, error: Exception) -> LogError:
    """What to say when a reader of python-can fails."""
    reason = " ".join(str(error).split()) or type(error).__name__
    return LogError(f"{path}: cannot be read as a CAN log: {reason}")


def _from_bus(meter: LoadMeter, bus: can.BusABC, seconds: float) -> int:
    """Count what comes; returns for how long, also when it was interrupted."""
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("listening"), BarColumn(), TimeRemainingColumn(), TextColumn("{task.fields[load]}"),
        console=console, transient=True, disable=not console.is_terminal,
    )  # fmt: skip
    start_ns = time.monotonic_ns()
    with contextlib.suppress(KeyboardInterrupt), contextlib.closing(_Shutdown(bus)), bar:
        task = bar.add_task("", total=seconds, load="")
        for message in messages(bus, seconds):
            if message is not None:
                _count(meter, (message,))
            passed_ns = time.monotonic_ns() - start_ns
            if console.is_terminal and passed_ns > 0:
                bar.update(task, completed=passed_ns / NS_PER_S, load=f"{meter.wire_ns / passed_ns:.1%}")
    return time.monotonic_ns() - start_ns


class _Shutdown:
    """`contextlib.closing` for a bus of any interface."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus

    def close(self) -> None:
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()


def _count(meter: LoadMeter, found: Iterable[can.Message]) -> None:
    for message in found:
        if message.is_error_frame:
            meter.errors += 1
            continue
        meter.add(
            WireFrame(
                round(message.timestamp * NS_PER_S),
                message.arbitration_id,
                bytes(message.data),
                message.is_extended_id,
                message.is_remote_frame,
                message.is_fd,
                message.bitrate_switch,
                message.error_state_indicator,
                message.dlc,
            )
        )


@contextlib.contextmanager
def _progress(path: Path, reader: Iterable[can.Message]) -> Iterator[Iterable[can.Message]]:
    """The reader's messages, with a count on a terminal: a log may hold hours."""
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("reading {task.description}"), TextColumn("{task.completed} frames"),
        console=console, transient=True, disable=not console.is_terminal,
    )  # fmt: skip

    def counted() -> Iterator[can.Message]:
        task = bar.add_task(path.name, total=None)
        for number, message in enumerate(reader):
            if number % 5000 == 0:
                bar.update(task, completed=number)
            yield message

    with bar:
        yield counted()


def _bitrate_of_hub(options: BusOptions) -> int | None:
    """The bit rate of a local bus that is up."""
    if options.interface != LOCAL_INTERFACE:
        return None
    try:
        rate = link.query(options.channel).get("bitrate")
    except (OSError, WireError, address.AddressError):
        return None  # opening it will say what is wrong
    return rate if isinstance(rate, int) else None


def _bitrate_of_run(directory: Path) -> int | None:
    """The bit rate that a run was made with, if its summary says so."""
    try:
        rate = json.loads((directory / "summary.json").read_text(encoding="utf-8"))["bus"]["bitrate"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return rate if isinstance(rate, int) and rate > 0 else None
