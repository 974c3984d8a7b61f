"""What a study is and what it hands back.

A module `studies/<name>.py` has one public function::

    def run(progress: Progress = silent) -> Study

and stands in `studies.registry.STUDIES`. It reports its progress, drives the laws of this program in the
paper's own experiment and returns rows, sentences and figures. It writes no files: `studies.report` does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from studies.figure import Figure
from studies.table import Row, row_json, summary_line

__all__ = ["Progress", "Study", "silent", "study_json"]

Progress = Callable[[str, float], None]
"""Called with what is being computed and how much is done, 0 to 1."""


def silent(what: str, done: float) -> None:
    """Progress that nobody watches."""


@dataclass(frozen=True)
class Study:
    """The result: the paper, its table, and what there is to say.

    `contradictions`: where the paper contradicts itself or physics, a sentence each. `assumptions`: what the
    paper leaves open and was chosen here, a sentence each.
    """

    name: str
    title: str
    paper: str
    rows: Sequence[Row]
    contradictions: Sequence[str] = ()
    assumptions: Sequence[str] = ()
    figures: Sequence[Figure] = ()


def study_json(study: Study) -> Mapping[str, Any]:
    """The study as one JSON document (without its figures' data)."""
    return {
        "study": study.name,
        "title": study.title,
        "paper": study.paper,
        "summary": summary_line(study.rows),
        "rows": [row_json(row) for row in study.rows],
        "contradictions": list(study.contradictions),
        "assumptions": list(study.assumptions),
        "figures": [f"{figure.name}.png" for figure in study.figures],
    }
