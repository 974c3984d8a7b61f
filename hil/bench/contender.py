"""Who takes part in a comparison: a law as the scenario has it, or with one of its presets (`pid:paper`)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

from hil.bench.errors import ScenarioError

ALL = "all"


@dataclass(frozen=True)
class Contender:
    """A law, and the preset of its parameters (`controller.<law>.preset`); None: as the scenario says."""

    law: str
    preset: str | None = None

    @property
    def name(self) -> str:
        """As the user writes it."""
        return self.law if self.preset is None else f"{self.law}:{self.preset}"

    def overrides(self) -> tuple[str, ...]:
        """Settings of the scenario that choose it."""
        chosen = [f"controller.law={json.dumps(self.law)}"]
        if self.preset is not None:
            chosen.append(f"controller.{self.law}.preset={json.dumps(self.preset)}")
        return tuple(chosen)


def contenders(text: str, laws: Sequence[str]) -> tuple[Contender, ...]:
    """Read `all`, or a list such as `pid,pid:paper,fuzzy_d`; each once, in the order given.

    ScenarioError: a law that there is not; the message lists those that there are.
    """
    words = [word.strip() for word in text.split(",") if word.strip()]
    found: dict[str, Contender] = {}
    for word in words:
        law, _, preset = word.partition(":")
        names = laws if law == ALL else (law,)
        if law not in (*laws, ALL):
            raise ScenarioError(f"--laws {text}: no law {law!r}; there are {', '.join(laws)} (or all)")
        for name in names:
            contender = Contender(name, preset or None)
            found.setdefault(contender.name, contender)
    if not found:
        raise ScenarioError(f"--laws {text!r}: name at least one law; there are {', '.join(laws)} (or all)")
    return tuple(found.values())
