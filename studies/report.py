"""Writes what a study hands back: study.json, study.csv, one PNG for each figure, study.rrd."""

from __future__ import annotations

import csv
import json
from pathlib import Path

from studies.draw import draw
from studies.study import Progress, Study, silent, study_json
from studies.table import row_json

__all__ = ["JSON_FILE", "RECORDING_FILE", "TABLE_FILE", "write"]

JSON_FILE, TABLE_FILE, RECORDING_FILE = "study.json", "study.csv", "study.rrd"


def write(study: Study, directory: Path, progress: Progress = silent) -> list[Path]:
    """Write all files of a study into a directory that exists; their paths, pictures first."""
    count = len(study.figures)
    files = draw(tuple(study.figures), directory, lambda n: progress("pictures", n / count))
    document = directory / JSON_FILE
    document.write_text(json.dumps(study_json(study), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    table = directory / TABLE_FILE
    with table.open("w", newline="", encoding="utf-8") as file:
        rows = [row_json(row) for row in study.rows]
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["quantity"])
        writer.writeheader()
        writer.writerows(rows)
    # Only now: the recording library takes a second to load.
    from studies.recording import record

    progress("recording", 0.0)
    recording = directory / RECORDING_FILE
    record(study, recording)
    progress("recording", 1.0)
    return [*files, document, table, recording]
