"""What counts as a deviation: tolerances per signal and an ignore list, from defaults, a file and options."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hil.bench.replay.recorded import ReplayError
from hil.canbus.codec import MessageCodec
from hil.canbus.contract import Contract
from hil.canbus.signals import SignalSpec

__all__ = [
    "HALF_A_STEP",
    "IGNORED",
    "LIVE_STEPS",
    "REAL_TIME_STEPS",
    "STAMPS_ONLY_STEPS",
    "Rules",
    "check_patterns",
    "load_rules",
]

IGNORED = ("*_Timing",)
"""Ignored by default, besides E2E counters and CRC: what a node measured of its own time."""

HALF_A_STEP, REAL_TIME_STEPS, STAMPS_ONLY_STEPS, LIVE_STEPS = 0.5, 5.5, 20.5, 20.5
"""Default tolerances in steps of the signal: in lockstep; in real time, where the cycles are known from the
timing ring; where they are known from the stamps of frames only; and live, where they are the device's own.
docs/replay.md says what was measured.
"""

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


@dataclass(frozen=True)
class Rules:
    """Patterns (`Message.Signal`, `*` allowed; `Message` for all of it) and what they say.

    `tolerance` is in the DBC's unit; the last pattern that fits wins. `steps`: tolerance of all other signals
    in steps of their resolution; states, flags and counts are compared exactly.
    """

    tolerance: Mapping[str, float] = field(default_factory=dict)
    ignore: tuple[str, ...] = IGNORED
    steps: float | None = None

    def with_default(self, steps: float) -> Rules:
        """The same rules; `steps` where nobody has said another number."""
        return self if self.steps is not None else replace(self, steps=steps)

    def tolerance_of(self, codec: MessageCodec, signal: SignalSpec) -> float:
        """Largest difference that is none, in the DBC's unit."""
        name = f"{codec.name}.{signal.name}"
        given = [value for pattern, value in self.tolerance.items() if fnmatchcase(name, pattern)]
        if given:
            return given[-1]
        if signal.integer or signal.choices:
            return 0.0
        return (HALF_A_STEP if self.steps is None else self.steps) * abs(signal.scale)

    def ignores(self, codec: MessageCodec, signal: SignalSpec) -> bool:
        """Whether a signal is not compared."""
        if signal.role != "NONE" or self.ignores_message(codec):
            return True
        return any(fnmatchcase(f"{codec.name}.{signal.name}", pattern) for pattern in self.ignore)

    def ignores_message(self, codec: MessageCodec) -> bool:
        """Whether a message is not compared at all, not even counted."""
        return any(fnmatchcase(codec.name, pattern.removesuffix(".*")) for pattern in self.ignore)


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    ignore: tuple[str, ...] = ()
    default_ignore: bool = True
    steps: NotNegative | None = None
    tolerance: dict[str, NotNegative] = Field(default_factory=dict)


def load_rules(
    path: Path | None, tolerances: Sequence[str], ignore: Sequence[str], contract: Contract
) -> Rules:
    """Defaults, then the file, then the options, each over the one before. Raises ReplayError.

    `tolerances` are `Message.Signal=value` in the DBC's unit. Every pattern has to fit something in the DBC.
    """
    file = _read(path) if path is not None else _File()
    given = dict(file.tolerance)
    for text in tolerances:
        name, value = _tolerance(text)
        given.pop(name, None)  # to the end: the last one wins
        given[name] = value
    patterns = (*file.ignore, *ignore)
    check_patterns((*given, *patterns), contract)
    return Rules(given, (*(IGNORED if file.default_ignore else ()), *patterns), file.steps)


def check_patterns(patterns: Iterable[str], contract: Contract) -> None:
    """Raises ReplayError for a pattern that fits nothing in the DBC: it would be obeyed in silence."""
    names = [
        f"{codec.name}.{signal.name}" for codec in contract.messages.values() for signal in codec.signals
    ]
    for pattern in patterns:
        message = pattern.removesuffix(".*")
        if any(fnmatchcase(name, pattern) for name in names):
            continue
        if any(fnmatchcase(codec, message) for codec in contract.messages):
            continue
        near = difflib.get_close_matches(pattern, [*names, *contract.messages], 3, 0.4)
        hint = f"nearest: {', '.join(near)}" if near else "a name is Message.Signal"
        raise ReplayError(f"{pattern}: fits no signal of {contract.path.name}; {hint}")


def _tolerance(text: str) -> tuple[str, float]:
    name, separator, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = -1.0
    if not separator or not 0.0 <= value < float("inf"):
        raise ReplayError(
            f"--tolerance {text}: expected Message.Signal=VALUE in the DBC's unit, 0 or more,"
            " for example ATO_Command.EffortDemand=0.5"
        )
    return name.strip(), value


def _read(path: Path) -> _File:
    try:
        return _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise ReplayError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ReplayError(f"{path}: not TOML: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ReplayError(f"{path}: {key}: {first['msg']}") from None
