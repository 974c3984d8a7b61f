"""The shipped lines, trains and scenarios, and how a name or a path becomes a file.

Lines and trains are TOML files of ours, or TTOBench JSON files, which are in `ttobench/` as published.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from hil.railway.errors import RailwayDataError
from hil.railway.files import choices, read_toml
from hil.railway.ttobench import ttobench_title


@dataclass(frozen=True)
class Entry:
    """One file of the library."""

    name: str
    title: str
    path: Path


def find_line(name_or_path: str, beside: Path | None = None) -> Path:
    """File of a line; see `find_scenario`. `beside` is the folder that a relative path starts from."""
    return _find("line", name_or_path, beside)


def find_train(name_or_path: str, beside: Path | None = None) -> Path:
    """File of a train; see `find_scenario`. `beside` is the folder that a relative path starts from."""
    return _find("train", name_or_path, beside)


def find_scenario(name_or_path: str, beside: Path | None = None) -> Path:
    """File of a scenario: a library name, or a path that ends in .toml (lines and trains: or .json).

    A relative path is looked up in `beside`, then in the working directory. RailwayDataError says
    which names there are, or that the file is missing.
    """
    return _find("scenario", name_or_path, beside)


def list_lines() -> tuple[Entry, ...]:
    """Shipped lines, by name."""
    return _list("line")


def list_trains() -> tuple[Entry, ...]:
    """Shipped trains, by name."""
    return _list("train")


def list_scenarios() -> tuple[Entry, ...]:
    """Shipped scenarios, by name."""
    return _list("scenario")


def _folder(kind: str) -> Path:
    return Path(str(files("hil.library"))) / f"{kind}s"


_TTOBENCH = {"line": "tracks", "train": "trains"}


def _shipped(kind: str) -> list[Path]:
    """Files of a kind, ours first."""
    paths = sorted(_folder(kind).glob("*.toml"))
    if kind in _TTOBENCH:
        paths += sorted((_folder(kind).parent / "ttobench" / _TTOBENCH[kind]).glob("*.json"))
    return paths


def _list(kind: str) -> tuple[Entry, ...]:
    return tuple(Entry(path.stem, _title(path), path) for path in _shipped(kind))


def _title(path: Path) -> str:
    return ttobench_title(path) if path.suffix == ".json" else str(read_toml(path).get("title", ""))


def _find(kind: str, name_or_path: str, beside: Path | None) -> Path:
    endings = (".toml", ".json") if kind in _TTOBENCH else (".toml",)
    if name_or_path.endswith(endings):
        given = Path(name_or_path).expanduser()
        for candidate in (given,) if beside is None else (beside / given, given):
            if candidate.is_file():
                return candidate
        raise RailwayDataError(f"{name_or_path}: no such {kind} file")
    shipped = {path.stem: path for path in _shipped(kind)}
    if name_or_path in shipped:
        return shipped[name_or_path]
    raise RailwayDataError(
        f"no {kind} {name_or_path!r} in the library; {choices(name_or_path, list(shipped))}; "
        f"or give the path of a {' or '.join(endings)} file"
    )
