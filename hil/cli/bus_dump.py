"""`hil bus dump`: the traffic as it comes, decoded by the DBC, or as candump writes it."""

from __future__ import annotations

import contextlib
import json
import math
import sys
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, TextIO

import can
import typer
from cantools.database import Database, DecodeError
from cantools.database.can import Message as DbcMessage

import dbc as shipped
from hil.canbus.analysis.message_set import MessageSetError
from hil.canbus.contract import read_database
from hil.cli.bus_live import live_options, messages, open_live
from hil.cli.bus_load import LOG_OF_RUN, LogError, unreadable


def dump(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[MESSAGE]...", help="Only these messages (names of the DBC)."),
    ] = None,
    interface: Annotated[str | None, typer.Option("-i", "--interface", help="python-can interface.")] = None,
    channel: Annotated[str | None, typer.Option("-c", "--channel", help="Channel of the bus.")] = None,
    bitrate: Annotated[int | None, typer.Option("-b", "--bitrate", help="Bit rate [bit/s].")] = None,
    fd: Annotated[bool, typer.Option("--fd", help="Open the bus for CAN FD.")] = False,
    log: Annotated[
        Path | None, typer.Option("--log", help="A run directory or a log instead of a bus.")
    ] = None,
    dbc: Annotated[Path | None, typer.Option("--dbc", help="Your DBC; default: the bench's.")] = None,
    raw: Annotated[
        bool, typer.Option("--raw", help="As candump -L writes it: canplayer reads that.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="A JSON document per frame and line, signals in the DBC's units.")
    ] = False,
    count: Annotated[int | None, typer.Option("-n", "--count", help="End after so many frames.")] = None,
    seconds: Annotated[float | None, typer.Option("--seconds", help="End after so many seconds.")] = None,
) -> int:
    """Show the frames on a bus with their signals, as candump shows their bytes.

    [bold]hil bus dump -c ato ODO_Motion ATO_Command[/bold]

    [bold]hil bus dump -c ato --raw | cantools decode my.dbc[/bold]

    [bold]hil bus dump --log runs/… ODO_Motion --json | jq .signals.Speed[/bold]
    """
    if raw and as_json:
        raise MessageSetError("--raw --json: one or the other")
    if count is not None and count < 1:
        raise MessageSetError(f"--count {count}: at least 1")
    if seconds is not None and not (math.isfinite(seconds) and seconds > 0.0):
        raise MessageSetError(f"--seconds {seconds:g}: must be above 0")
    path = shipped.path() if dbc is None else dbc
    database = read_database(path)
    wanted = _wanted(database, names or [], path.name)
    if log is not None:
        source, place = _logged(log), "log"
    else:
        options = live_options(interface, channel, bitrate, fd=fd)
        source, place = _live(open_live(options, "hil bus dump"), seconds), options.channel
    left = count
    with contextlib.suppress(KeyboardInterrupt):
        for message in source:
            key = (message.arbitration_id, message.is_extended_id)
            if wanted is not None and (message.is_error_frame or key not in wanted):
                continue
            if raw:
                line = candump_line(message, place)
            else:
                line = (json_line if as_json else decoded_line)(message, database)
            _print(line, sys.stdout)
            if left is not None:
                left -= 1
                if not left:
                    break
    return 0


def candump_line(message: can.Message, channel: str) -> str:
    """A frame as `candump -L` writes it (can-utils)."""
    if message.is_error_frame:
        number = f"{message.arbitration_id | 0x2000_0000:08X}"
    else:
        number = f"{message.arbitration_id:0{8 if message.is_extended_id else 3}X}"
    data = message.data.hex().upper()
    if message.is_remote_frame:
        data = "R" + (str(message.dlc) if message.dlc else "")
    elif message.is_fd:
        data = f"#{message.bitrate_switch | message.error_state_indicator << 1:X}{data}"
    return f"({message.timestamp:.6f}) {channel} {number}#{data}"


def decoded_line(message: can.Message, database: Database) -> str:
    """Time of day, identifier, name, signals with their units; the bytes where the DBC does not know them."""
    time = datetime.fromtimestamp(message.timestamp).strftime("%H:%M:%S.%f")
    number = f"0x{message.arbitration_id:0{8 if message.is_extended_id else 3}X}"
    if message.is_error_frame:
        return f"{time}  {number}  error frame  {message.data.hex(' ').upper()}"
    known = _known(database, message)
    name = "-" if known is None else known.name
    if message.is_remote_frame:
        text = "remote frame"
    elif known is None:
        text = message.data.hex(" ").upper()
    else:
        text = _signals(known, bytes(message.data))
    return f"{time}  {number}  {name:<16}  {text}".rstrip()


def json_line(message: can.Message, database: Database) -> str:
    """A frame as one JSON document: `time` [s since 1970], `id`, `name`, `data` in hex, `signals`.

    Signals are in the DBC's units, named values as their names; None where the DBC does not know the message
    or its data do not fit.
    """
    known = None if message.is_error_frame else _known(database, message)
    signals: dict[str, Any] | None = None
    if known is not None and not message.is_remote_frame:
        with contextlib.suppress(DecodeError, ValueError):
            values = known.decode(bytes(message.data), allow_truncated=True)
            if isinstance(values, dict):
                signals = {
                    name: value if isinstance(value, int | float) else str(value)
                    for name, value in values.items()
                }
    return json.dumps(
        {
            "time": round(message.timestamp, 9),
            "id": message.arbitration_id,
            "extended": message.is_extended_id,
            "kind": _kind(message),
            "name": None if known is None else known.name,
            "data": bytes(message.data).hex().upper(),
            "signals": signals,
        }
    )


def _kind(message: can.Message) -> str:
    if message.is_error_frame:
        return "error"
    if message.is_remote_frame:
        return "remote"
    return "fd" if message.is_fd else "data"


def _signals(known: DbcMessage, data: bytes) -> str:
    try:
        values = known.decode(data, allow_truncated=True)
    except (DecodeError, ValueError) as error:
        return f"{data.hex(' ').upper()}  (does not fit the DBC: {error})"
    if not isinstance(values, dict):
        return data.hex(" ").upper()
    parts = []
    for signal in known.signals:
        if signal.name in values:
            value = values[signal.name]
            number = f"{value:.10g}" if isinstance(value, int | float) else str(value)
            unit = f" {signal.unit}" if signal.unit and isinstance(value, int | float) else ""
            parts.append(f"{signal.name}={number}{unit}")
    return "  ".join(parts)


def _known(database: Database, message: can.Message) -> DbcMessage | None:
    try:
        found = database.get_message_by_frame_id(message.arbitration_id, message.is_extended_id)
    except KeyError:
        return None
    return found


def _wanted(database: Database, names: Sequence[str], source: str) -> set[tuple[int, bool]] | None:
    """Identifiers of the messages asked for; None: all."""
    by_name = {message.name: message for message in database.messages}
    for name in names:
        if name not in by_name:
            raise MessageSetError(f"{source}: no message {name!r}; it has {', '.join(by_name)}")
    if not names:
        return None
    return {(by_name[name].frame_id, by_name[name].is_extended_frame) for name in names}


def _live(bus: can.BusABC, seconds: float | None) -> Iterator[can.Message]:
    try:
        yield from (message for message in messages(bus, seconds) if message is not None)
    finally:
        with contextlib.suppress(can.CanError, OSError):
            bus.shutdown()


def _logged(log: Path) -> Iterator[can.Message]:
    path = log / LOG_OF_RUN if log.is_dir() else log
    if not path.is_file():
        raise LogError(f"{path}: no such log (expected a run directory with {LOG_OF_RUN}, or a log file)")
    try:
        with can.LogReader(path) as reader:
            yield from reader
    except Exception as error:  # readers of files from outside also end in struct.error, KeyError and others
        raise unreadable(path, error) from None


def _print(line: str, stream: TextIO) -> None:
    stream.write(line + "\n")
    stream.flush()
