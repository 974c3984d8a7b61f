"""What a run directory tells: summary, scenario, line, recording, files; and what is missing there."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from hil.bench.errors import ScenarioError
from hil.railway import Journey, load_journey
from hil.railway.errors import RailwayDataError

if TYPE_CHECKING:
    from hil.record import RunData

__all__ = ["FileLink", "RunSource", "links", "open_source"]

SUMMARY, SCENARIO = "summary.json", "scenario.toml"
FILES = {
    "run.rrd": "recording for the Rerun viewer: hil view",
    "frames.blf": "every frame, for any CAN tool",
    SUMMARY: "verdict and figures, for programs",
    "junit.xml": "criteria as tests, for CI",
    SCENARIO: "the scenario as it was run",
}


@dataclass(frozen=True)
class FileLink:
    """A file beside the report: `href` relative to the report, None if the file is not there."""

    name: str
    what: str
    href: str | None
    size: str = ""


@dataclass(frozen=True)
class RunSource:
    """A run as it lies on disk. `missing` says in sentences what is not there and what that leaves out."""

    folder: Path
    name: str
    summary: Mapping[str, Any]
    scenario_text: str
    journey: Journey | None
    recording: RunData | None
    missing: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """`passed`, `failed`, `aborted`, or `unknown` without a summary."""
        return str(self.summary.get("verdict", "unknown"))

    @property
    def real_time(self) -> bool:
        """Whether the run was one in real time."""
        return self.properties.get("mode") == "real-time"

    @cached_property
    def properties(self) -> dict[str, Any]:
        """What the run was: from the recording, else from the summary."""
        known = self.recording.properties if self.recording is not None else {}
        return {
            **known,
            **{key: self.summary[key] for key in ("scenario", "law", "seed", "mode") if key in self.summary},
        }

    @property
    def title(self) -> str:
        """Title of the scenario, or its name."""
        return str(self.properties.get("title") or self.properties.get("scenario") or self.name)


def open_source(run: Path) -> RunSource:
    """Read what there is of a run directory (or of the directory of an .rrd).

    Raises ScenarioError if it holds neither a summary nor a recording.
    """
    folder = run if run.is_dir() else run.parent
    if not any((folder / name).is_file() for name in (SUMMARY, "run.rrd", "frames.blf")) or not run.exists():
        raise ScenarioError(
            f"{run}: no run there (expected a directory with {SUMMARY} or run.rrd, as hil run leaves it)"
        )
    missing: list[str] = []
    summary = _summary(folder / SUMMARY, missing)
    recording = _recording(folder, missing)
    text, journey = _scenario(folder / SCENARIO, missing)
    name = folder.resolve().name
    return RunSource(folder, name, summary, text, journey, recording, tuple(missing))


def links(source: RunSource, beside: Path, more: Sequence[str] = ()) -> list[FileLink]:
    """The run's files, and `more` of its folder, as links from a report in the folder `beside`."""
    found = [_link(source.folder / name, name, what, beside) for name, what in FILES.items()]
    found += [_link(source.folder / name, name, "", beside) for name in more]
    for pattern, what in (("frames.*", "frame log"), ("logs/*.log", "what the process said")):
        for path in sorted(source.folder.glob(pattern)):
            name = path.relative_to(source.folder).as_posix()
            if name not in FILES and path.is_file():
                found.append(_link(path, name, what, beside))
    return found


def _link(path: Path, name: str, what: str, beside: Path) -> FileLink:
    if not path.is_file():
        return FileLink(name, what, None)
    size = path.stat().st_size
    relative = Path(os.path.relpath(path, beside)).as_posix()
    return FileLink(name, what, quote(relative), _size(size))


def _size(size: int) -> str:
    if not size:
        return "empty"
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{max(size / 1e3, 0.1):.1f} kB"


def _summary(path: Path, missing: list[str]) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        missing.append(f"{path.name} is not there: the run was not judged, or did not get that far.")
        return {}
    except (OSError, ValueError) as error:
        missing.append(f"{path.name} cannot be read: {error}")
        return {}
    if not isinstance(content, dict):
        missing.append(f"{path.name} is not a summary of a run.")
        return {}
    return content


def _recording(folder: Path, missing: list[str]) -> RunData | None:
    # Only now: a large library, and a run may have no recording.
    from hil.record import open_run

    if not (folder / "frames.blf").is_file():
        missing.append("frames.blf is not there: no frame log for other CAN tools.")
    try:
        recording = open_run(folder)
    except Exception as error:  # whatever is wrong with the file, the rest of the report stands
        missing.append(f"No recording can be read, so there are no pictures: {_one_line(error)}")
        return None
    if recording.warning:
        missing.append(f"{recording.warning[:1].upper()}{recording.warning[1:]}.")
    return recording


def _scenario(path: Path, missing: list[str]) -> tuple[str, Journey | None]:
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        missing.append(f"{path.name} is not there: line, limits and stations are not drawn.")
        return "", None
    try:
        return text, load_journey(path)
    except (RailwayDataError, OSError, ValueError) as error:
        missing.append(f"Line, limits and stations are not drawn: {_one_line(error)}")
        return text, None


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
