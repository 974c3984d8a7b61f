"""`hil export`: a recording in the formats of other tools."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from hil.bench.errors import ScenarioError

SIGNALS_MF4 = "signals.mf4"


def export(
    run: Annotated[Path, typer.Argument(help="A run directory, an .rrd file, or a frame log.")],
    csv: Annotated[bool, typer.Option("--csv", help="Decoded signals as text.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="Decoded signals for pandas.")] = False,
    mf4: Annotated[
        bool, typer.Option("--mf4", help="ASAM MDF 4: signals.mf4 (decoded) and frames.mf4 (bus logging).")
    ] = False,
    asc: Annotated[bool, typer.Option("--asc", help="Frames as Vector ASC.")] = False,
    blf: Annotated[bool, typer.Option("--blf", help="Frames as Vector BLF.")] = False,
    log: Annotated[bool, typer.Option("--log", help="Frames as candump -L writes them.")] = False,
    trc: Annotated[bool, typer.Option("--trc", help="Frames as PEAK TRC; no CAN FD.")] = False,
    signals: Annotated[
        list[str] | None,
        typer.Option("--signal", metavar="NAME", help="Only these signals in CSV, Parquet and signals.mf4."),
    ] = None,
    per_message: Annotated[
        bool,
        typer.Option("--per-message", help="A table per message at its own stamps, not one on the cycles."),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Directory of the files [RUN/export].")] = None,
    dbc: Annotated[Path | None, typer.Option(help="DBC of a frame log; a recording carries its own.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document and nothing else.")] = False,
) -> None:
    """Write a recording in formats that other tools read.

    [bold]hil export RUN --mf4[/bold]                     for asammdf, CANape, MATLAB

    [bold]hil export RUN --csv --signal ODO_Motion.Speed --signal plant_sim.speed_mps[/bold]

    [bold]hil export RUN --asc --log --out /tmp/logs[/bold]  frames for CANoe, can-utils, cantools
    """
    tables = [kind for kind, wanted in (("csv", csv), ("parquet", parquet)) if wanted]
    wanted_logs = {"asc": asc, "blf": blf, "log": log, "trc": trc, "mf4": mf4}
    logs = [kind for kind, wanted in wanted_logs.items() if wanted]
    if not tables and not logs:
        raise ScenarioError("hil export: no format; choose of --csv --parquet --mf4 --asc --blf --log --trc")
    from hil.record import open_run
    from hil.record.log_formats import FRAME_FORMATS, check_formats, convert_log
    from hil.record.recorder import FRAME_LOG
    from hil.record.table_files import write_measurement, write_tables

    check_formats(logs)
    console = Console(stderr=True, soft_wrap=True, highlight=False)
    folder = out if out is not None else (run if run.is_dir() else run.parent) / "export"
    is_log = run.suffix.lstrip(".") in FRAME_FORMATS
    source = run if is_log else (run if run.is_dir() else run.parent) / FRAME_LOG
    made: list[dict[str, Any]] = []
    try:
        with console.status("exporting"):
            recording = open_run(run, dbc=dbc) if tables or mf4 or not source.is_file() else None
            folder.mkdir(parents=True, exist_ok=True)
            if recording is not None:
                for kind in tables:
                    for path in write_tables(
                        recording, folder, kind, per_message=per_message, signals=signals or ()
                    ):
                        made.append({"file": str(path)})
                if mf4:
                    path = folder / SIGNALS_MF4
                    channels = write_measurement(recording, path, signals or ())
                    made.append({"file": str(path), "channels": channels})
            if logs and not source.is_file():
                raise ScenarioError(f"{run}: no frame log there (expected {FRAME_LOG}); no frames to export")
            for path, frames, left_out in convert_log(source, folder, logs).values():
                made.append({"file": str(path), "frames": frames, "left_out": left_out})
    except OSError as error:
        place = error.filename or folder
        raise ScenarioError(f"{place}: cannot be written: {error.strerror or error}") from None
    for row in made:
        row["bytes"] = Path(row["file"]).stat().st_size
    if as_json:
        typer.echo(json.dumps({"files": made}, indent=2))
        return
    for row in made:
        count = f", {row['frames']} frames" if "frames" in row else ""
        count += f", {row['channels']} channels" if "channels" in row else ""
        typer.echo(f"{row['file']}: {row['bytes'] / 1e3:.0f} kB{count}")
        if row.get("left_out"):
            typer.echo(
                f"hil export: {row['file']}: {row['left_out']} frames left out, the format cannot hold them",
                err=True,
            )
