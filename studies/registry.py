"""The studies by name. Only the one that is asked for is imported."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from importlib import import_module
from types import MappingProxyType
from typing import NamedTuple, cast

from studies.errors import StudyError
from studies.study import Progress, Study

__all__ = ["STUDIES", "StudyEntry", "entry"]


class StudyEntry(NamedTuple):
    """A study as it is listed: name, what it is about, and the paper."""

    name: str
    title: str
    paper: str

    def run(self, progress: Progress) -> Study:
        """Import the study and run it."""
        module = import_module(f"studies.{self.name}")
        return cast(Callable[[Progress], Study], module.run)(progress)


_ENTRIES = (
    StudyEntry(
        "fuzzy_d",
        "PID, SpeedT and Fuzzy-D on a 2 km line",
        "Nguyen Van Tiem 2020, doi:10.25073/tcsj.71.6.1",
    ),
    StudyEntry(
        "fsmc",
        "Sliding mode and fuzzy sliding mode under uncertainty",
        "Radmehr and Zarabadipour 2021 (in Persian)",
    ),
    StudyEntry(
        "fuzzy_pid",
        "Fuzzy PID on a 36 km main line",
        "Zhou Hongbin 2014, article 1009-914X(2014)18-0111-01 (in Chinese)",
    ),
    StudyEntry(
        "dynamic_programming",
        "Energy-optimal speed profile by dynamic programming",
        "Tran Van K. et al. 2021, doi:10.47869/tcsj.72.3.7",
    ),
)

STUDIES: Mapping[str, StudyEntry] = MappingProxyType({study.name: study for study in _ENTRIES})
"""By the name that `hil study` takes."""


def entry(name: str) -> StudyEntry:
    """The study of this name. StudyError names the one that was probably meant."""
    if name in STUDIES:
        return STUDIES[name]
    near = get_close_matches(name, STUDIES, 1, 0.4)
    hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(STUDIES)}"
    raise StudyError(f"no study {name!r}: {hint}")
