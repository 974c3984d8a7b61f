"""What the shell completes: scenarios, laws, lines, trains, runs, nodes, keys of a scenario.

Called by the shell at every TAB: nothing here may be slow, print, or fail.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

__all__ = [
    "complete_law_list",
    "complete_laws",
    "complete_lines",
    "complete_nodes",
    "complete_overrides",
    "complete_runs",
    "complete_scenarios",
    "complete_trains",
]

Words = list[tuple[str, str]]
"""Words with the help that a shell may show beside them."""

NODES = {"controller": "the ATO unit", "plant_sim": "train, drives, brakes, odometer, protection"}
LOG_SUFFIXES = (".blf", ".asc", ".log", ".trc", ".mf4", ".rrd")
KEYS = ("controller.law=", "controller.period_s=", "journey.seed=", "journey.time_s=", "plant.period_s=")
MOST_RUNS, LONGEST_HELP = 50, 48


def complete_scenarios(incomplete: str) -> Words:
    """Shipped scenarios, and TOML files."""
    from hil.railway.library import list_scenarios

    shipped = [(entry.name, entry.title) for entry in list_scenarios()]
    return _fitting([*shipped, *_files(incomplete, (".toml",))], incomplete)


def complete_lines(incomplete: str) -> Words:
    """Shipped lines, and TOML files."""
    from hil.railway.library import list_lines

    shipped = [(entry.name, entry.title) for entry in list_lines()]
    return _fitting([*shipped, *_files(incomplete, (".toml",))], incomplete)


def complete_trains(incomplete: str) -> Words:
    """Shipped trains, and TOML files."""
    from hil.railway.library import list_trains

    shipped = [(entry.name, entry.title) for entry in list_trains()]
    return _fitting([*shipped, *_files(incomplete, (".toml",))], incomplete)


def complete_laws(incomplete: str) -> Words:
    """Control laws."""
    from controller.laws.selection import LAWS

    return _fitting([(name, entry.title) for name, entry in LAWS.items()], incomplete)


def complete_law_list(incomplete: str) -> Words:
    """Control laws separated by commas; the last one is completed."""
    before, comma, last = incomplete.rpartition(",")
    return [(before + comma + name, title) for name, title in complete_laws(last)]


def complete_nodes(incomplete: str) -> Words:
    """The nodes that can be played to."""
    return _fitting(list(NODES.items()), incomplete)


def complete_overrides(incomplete: str) -> Words:
    """Keys of a scenario; after `controller.law=` the laws."""
    key = "controller.law="
    if incomplete.startswith(key):
        return [(key + name, title) for name, title in complete_laws(incomplete.removeprefix(key))]
    return _fitting([(key, "") for key in KEYS], incomplete)


def complete_runs(incomplete: str) -> Words:
    """Run directories, the newest first, and frame logs."""
    return _fitting([*_runs(), *_files(incomplete, LOG_SUFFIXES)], incomplete)


def _runs() -> Words:
    try:
        runs = [folder for folder in Path("runs").iterdir() if (folder / "scenario.toml").is_file()]
    except OSError:
        return []
    return [(str(run), "") for run in sorted(runs, reverse=True)[:MOST_RUNS]]


def _files(incomplete: str, suffixes: tuple[str, ...]) -> Words:
    """Folders and files of these kinds where the incomplete path points to."""
    folder = Path(incomplete) if incomplete.endswith("/") else Path(incomplete).parent
    try:
        found = sorted(folder.iterdir())
    except OSError:
        return []
    names = []
    for path in found:
        if path.name.startswith("."):
            continue
        if path.is_dir():
            names.append((f"{path}/", ""))
        elif path.suffix in suffixes:
            names.append((str(path), ""))
    return names


def _fitting(words: Words, incomplete: str) -> Words:
    """Each word once; its help on one line, whatever the shell makes of a longer one."""
    found = {word: text for word, text in words if word.startswith(incomplete)}
    return [(word, textwrap.shorten(text, LONGEST_HELP, placeholder="…")) for word, text in found.items()]
