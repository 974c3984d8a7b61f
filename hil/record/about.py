"""What a recording says of the run as a whole: properties, the page about it, and afterwards the verdict."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from hil.record.dashboard import GREEN, GREY, RED
from hil.record.errors import RecordingUnreadable
from hil.record.rrd import open_rrd
from hil.record.viewer import viewer_binary

__all__ = [
    "DRAWN",
    "RUN_DOCUMENT",
    "VERDICT_DOCUMENT",
    "VERDICT_LANE",
    "add_verdict",
    "host",
    "own_version",
    "run_table",
]

DRAWN = ("track", "law_picture")
"""Properties that are drawn instead of told."""

RUN_DOCUMENT = "/about/run"
VERDICT_DOCUMENT = "/about/verdict"
VERDICT_LANE = "/state/Verdict"
PENDING = "PENDING"
NS_PER_S = 1e9


@cache
def host() -> dict[str, str]:
    """The machine: system, kernel, processor, number of CPUs. Not its name."""
    return {
        "system": platform.system(),
        "kernel": platform.release(),
        "machine": platform.machine(),
        "processor": _processor(),
        "cpus": str(os.cpu_count() or 0),
    }


def own_version() -> str:
    """Version of the bench itself."""
    try:
        return version("ato-hil")
    except PackageNotFoundError:
        return "not installed"


def run_table(run: Mapping[str, Any], versions: Mapping[str, str], machine: Mapping[str, str]) -> str:
    """The page about a run, in Markdown."""
    rows = {**run, **{f"host: {key}": value for key, value in machine.items() if value}}
    rows["versions"] = ", ".join(f"{name} {number}" for name, number in versions.items())
    lines = ["| | |", "|:---|:---|"]
    lines += [f"| {name} | {_shown(value)} |" for name, value in rows.items()]
    return "\n".join(lines)


def add_verdict(recording: Path, summary: Mapping[str, Any]) -> None:
    """Add to a finished recording how its run was judged: property, event, lane and table.

    `summary` is what summary.json holds. The rest of the recording stays as it is; it is replaced in one
    step. Raises RecordingUnreadable.
    """
    entry = open_rrd(recording).recordings()[0]
    extra = recording.with_name(f"{recording.name}.{os.getpid()}.verdict")
    merged = recording.with_name(f"{recording.name}.{os.getpid()}.new")
    try:
        stream = rr.RecordingStream(
            entry.application_id, recording_id=entry.recording_id, send_properties=False
        )
        stream.set_sinks(rr.FileSink(extra, write_footer=True))
        stream.set_log_time_enabled(False)
        _write_verdict(stream, summary, _last_instant(recording))
        stream.disconnect()
        command = [str(viewer_binary()), "rrd", "merge", str(recording), str(extra), "-o", str(merged)]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False, text=True)
        if done.returncode != 0 or not merged.is_file():
            words = " ".join(done.stderr.split())[-200:]
            raise RecordingUnreadable(f"{recording}: the verdict could not be added: {words}")
        os.replace(merged, recording)
    finally:
        extra.unlink(missing_ok=True)
        merged.unlink(missing_ok=True)


def verdict_table(summary: Mapping[str, Any]) -> str:
    """Verdict and criteria in Markdown."""
    verdict = str(summary.get("verdict", "unknown"))
    lines = [f"# {verdict}", ""]
    if summary.get("ended") != "arrived" and summary.get("ended_because"):
        lines += [str(summary["ended_because"]), ""]
    lines += ["| criterion | value | limit | unit | |", "|:---|---:|---:|:---|:---|"]
    for row in summary.get("criteria", ()):
        value = "-" if row["value"] is None else f"{row['value']:.4g}"
        mark = "passed" if row["passed"] else "**failed**"
        lines.append(f"| {row['name']} | {value} | {row['limit']:g} | {row['unit']} | {mark} |")
    return "\n".join(lines)


def _write_verdict(
    stream: rr.RecordingStream, summary: Mapping[str, Any], ends: Mapping[str, tuple[int, int]]
) -> None:
    verdict = str(summary.get("verdict", "unknown"))
    failed = [row["name"] for row in summary.get("criteria", ()) if not row["passed"]]
    stream.send_property("verdict", rr.AnyValues(verdict=verdict, failed=", ".join(failed)))
    document = rr.TextDocument(verdict_table(summary), media_type=rr.MediaType.MARKDOWN)
    stream.log(VERDICT_DOCUMENT, document, static=True)
    states = [PENDING, "PASSED", "FAILED", "ABORTED"]
    colors = np.array([GREY, GREEN, RED, RED], dtype=np.uint32)
    stream.log(VERDICT_LANE, rr.StateConfiguration(values=states, labels=states, colors=colors), static=True)
    if not ends:
        return
    stream.send_columns(
        VERDICT_LANE, _instants(ends, (0, 1)), rr.StateChange.columns(state=[PENDING, verdict.upper()])
    )
    text = f"verdict: {verdict}" + (f"; failed: {', '.join(failed)}" if failed else "")
    level = "INFO" if verdict == "passed" else "ERROR"
    stream.send_columns(
        "/events/BENCH", _instants(ends, (1,)), rr.TextLog.columns(text=[text], level=[level])
    )


def _instants(ends: Mapping[str, tuple[int, int]], which: tuple[int, ...]) -> list[rr.TimeColumn]:
    columns = []
    for name, places in ends.items():
        values = np.array([places[k] for k in which], np.int64)
        if name == "bus_time":
            columns.append(rr.TimeColumn(name, timestamp=values.astype("datetime64[ns]")))
        elif name == "sim_time":
            columns.append(rr.TimeColumn(name, duration=values.astype("timedelta64[ns]")))
        else:
            columns.append(rr.TimeColumn(name, sequence=values))
    return columns


def _last_instant(recording: Path) -> dict[str, tuple[int, int]]:
    """First and last place on every timeline, from what was sent on the bus."""
    import pyarrow as pa

    ends: dict[str, tuple[int, int]] = {}
    for chunk in open_rrd(recording).stream().filter(content=["/state/**", "/levels/**"], is_static=False):
        batch = chunk.to_record_batch()
        for name in ("bus_time", "sim_time", "cycle", "position"):
            if name in batch.schema.names and batch.num_rows:
                values = batch.column(name).cast(pa.int64()).to_numpy(zero_copy_only=False)
                low, high = ends.get(name, (int(values.min()), int(values.max())))
                ends[name] = (min(low, int(values.min())), max(high, int(values.max())))
    return ends


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor()


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
