"""What a comparison leaves on disk as numbers: compare.json, and compare.csv with one row a run."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from hil.bench.compare import Comparison
from hil.bench.sets import SETS
from hil.bench.spread import spread
from hil.bench.summary import environment
from hil.bench.trial import TrialResult

JSON_FILE, CSV_FILE = "compare.json", "compare.csv"


def document(comparison: Comparison) -> dict[str, Any]:
    """All numbers of a comparison in JSON types; SI units, energies at the wheel rim."""
    request = comparison.request
    return {
        "scenario": request.scenario,
        "overrides": list(request.overrides),
        "set": request.set_name if request.runs else None,
        "drawn": [setting.__dict__ for setting in SETS[request.set_name]] if request.runs else [],
        "seed": request.seed,
        "runs": request.runs,
        "done": comparison.done,
        "total": request.total,
        "interrupted": comparison.interrupted,
        "laws": {contender.name: _law(comparison, contender.name) for contender in request.contenders},
        "environment": environment(),
    }


def write_files(comparison: Comparison, folder: Path) -> dict[str, Any]:
    """Write both files; returns the document."""
    content = document(comparison)
    (folder / JSON_FILE).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    rows = [_row(result) for result in _all(comparison)]
    names = list(dict.fromkeys(name for row in rows for name in row))
    with (folder / CSV_FILE).open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
    return content


def _law(comparison: Comparison, name: str) -> dict[str, Any]:
    nominal, drawn = comparison.nominal.get(name), comparison.drawn.get(name, [])
    worst = None
    if drawn:
        number = spread(drawn).worst_draw
        worst = _told(next(result for result in drawn if result.draw.number == number))
    return {
        "nominal": None if nominal is None else {"failure": nominal.failure, **nominal.numbers()},
        "spread": spread(drawn).as_dict() if drawn else None,
        "worst": worst,
        "failures": [_told(result) for result in drawn if result.failure],
    }


def _told(result: TrialResult) -> dict[str, Any]:
    return {
        "draw": result.draw.number,
        "failure": result.failure,
        "stop_error_m": result.metrics.stop_error_m,
        "settings": dict(result.draw.settings),
    }


def _row(result: TrialResult) -> dict[str, Any]:
    return {
        "law": result.contender.name,
        "draw": result.draw.number,
        "failure": result.failure,
        **result.numbers(),
        **result.draw.settings,
    }


def _all(comparison: Comparison) -> list[TrialResult]:
    return sorted(comparison.results, key=lambda result: result.draw.number)
