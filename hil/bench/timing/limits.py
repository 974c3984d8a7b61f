"""What a host has to hold to pass `hil timing`: limits from a TOML file, and the judgement by them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

import hil.library
from hil.bench.timing.request import FULL, FULL_ALONE, LOOP_PLAIN, LOOP_SPIN, PEER
from hil.bench.timing.samples import Measured, Spread, median_of_slices, ratio, spread
from hil.railway.files import FileModel, read_toml, validate

__all__ = ["DEFAULT_LIMITS", "Judged", "TimingLimits", "judge", "load_limits"]

DEFAULT_LIMITS = Path(hil.library.__file__).parent / "timing.toml"
Limit = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=False)]
NEEDED = {"p50": 20, "p99": 300, "p999": 3000, "max": 20}
"""Cycles that a percentile needs before it is judged: three that lie above it."""


class RatioLimits(FileModel):
    """`[ratio_to_cyclictest]`: wake-up latency of a part over cyclictest's, in the same minutes."""

    plain_p99: Limit | None = None
    spin_p99: Limit | None = None
    spin_p999: Limit | None = None
    full_p99: Limit | None = None
    full_p999: Limit | None = None


class SpreadLimits(FileModel):
    """Limits of a distribution, us."""

    p50: Limit | None = None
    p99: Limit | None = None
    p999: Limit | None = None
    max: Limit | None = None


class MissLimits(FileModel):
    """`[deadlines]`: `missed` in all; `unseen` by the witness, which only a run with cyclictest can tell."""

    missed: Annotated[int, Field(ge=0)] | None = None
    unseen: Annotated[int, Field(ge=0)] | None = None


class RecorderLimits(FileModel):
    """`[recorder]`: p99 of the wake-up latency in the median slice with the recorder may be `p99_ratio` times
    that without it.

    Below `allowance_us` more it passes in any case: of single microseconds ten per cent mean nothing.
    """

    p99_ratio: Limit | None = None
    allowance_us: Annotated[float, Field(ge=0, strict=False)] = 0.0


class TimingLimits(FileModel):
    """A file of limits. What it leaves out is measured and not judged."""

    schema_: Annotated[int, Field(alias="schema", ge=1, le=1)]
    ratio_to_cyclictest: RatioLimits = RatioLimits()
    wakeup_latency_us: SpreadLimits = SpreadLimits()
    execution_us: SpreadLimits = SpreadLimits()
    signal_age_us: SpreadLimits = SpreadLimits()
    command_latency_us: SpreadLimits = SpreadLimits()
    deadlines: MissLimits = MissLimits()
    recorder: RecorderLimits = RecorderLimits()


@dataclass(frozen=True)
class Judged:
    """One limit under one condition. `passed` None: not judged, `why` says why not."""

    name: str
    condition: str
    value: float | None
    limit: float
    unit: str
    passed: bool | None
    why: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        row = asdict(self)
        row["value"] = None if self.value is None else round(self.value, 4)
        return row


def load_limits(path: Path | None = None) -> TimingLimits:
    """The limits of a file, or those shipped. Raises RailwayDataError: file, key, value and limit."""
    file = path or DEFAULT_LIMITS
    return validate(TimingLimits, read_toml(file), file)


def judge(limits: TimingLimits, measured: Mapping[tuple[str, str], Measured]) -> list[Judged]:
    """Every limit under every condition that was measured."""
    conditions = list(dict.fromkeys(condition for condition, _ in measured))
    rows: list[Judged] = []
    for condition in conditions:
        parts = {part: known for (where, part), known in measured.items() if where == condition}
        rows += _ratios(limits.ratio_to_cyclictest, parts, condition)
        if FULL in parts:
            rows += _spreads(limits, parts[FULL], condition)
            rows += _deadlines(limits.deadlines, parts[FULL], condition)
            rows += _recorder(limits.recorder, parts, condition)
    return rows


def verdict(rows: list[Judged]) -> str:
    """`failed` if a limit was exceeded, else `passed`, or `not judged` if no limit could be judged."""
    judged = [row.passed for row in rows if row.passed is not None]
    if not judged:
        return "not judged"
    return "passed" if all(judged) else "failed"


def _ratios(limits: RatioLimits, parts: Mapping[str, Measured], condition: str) -> Iterator[Judged]:
    peer = spread(parts[PEER].wakeup_latency_us) if PEER in parts else None
    names = {"plain": LOOP_PLAIN, "spin": LOOP_SPIN, "full": FULL}
    for key, limit in limits:
        if limit is None:
            continue
        short, _, percentile = key.partition("_")
        if names[short] not in parts or (peer is None and LOOP_PLAIN not in parts):  # not asked for
            continue
        known = parts[names[short]]
        ours = spread(known.wakeup_latency_us)
        value = ratio(ours, peer, percentile)
        why = _too_few(percentile, ours, peer) if peer is not None else "cyclictest did not run"
        if not why and short == "full" and not _spins(known):
            why = "the node does not spin: its limit is for sleep + spin"
        name = f"{SHORT[names[short]]}: wake-up {PERCENTILE[percentile]} / cyclictest's"
        yield _row(name, condition, value, limit, "", why)


def _spreads(limits: TimingLimits, known: Measured, condition: str) -> Iterator[Judged]:
    kinds = {
        "wakeup_latency_us": "control node: wake-up",
        "execution_us": "control step: execution",
        "signal_age_us": "signal age",
        "command_latency_us": "command latency",
    }
    for field, title in kinds.items():
        values = spread(known.values(field))
        for percentile, limit in getattr(limits, field):
            if limit is not None:
                value = None if values is None else float(getattr(values, percentile))
                why = _too_few(percentile, values)
                yield _row(f"{title} {PERCENTILE[percentile]}", condition, value, limit, "us", why)


def _deadlines(limits: MissLimits, known: Measured, condition: str) -> Iterator[Judged]:
    if limits.missed is not None:
        yield _row("deadlines missed", condition, sum(known.missed().values()), limits.missed, "")
    if limits.unseen is not None:
        unseen = known.unseen
        why = "" if unseen is not None else "no witness: cyclictest did not run, or has no --spike"
        yield _row("deadlines missed unseen by the witness", condition, unseen, limits.unseen, "", why)


def _recorder(limits: RecorderLimits, parts: Mapping[str, Measured], condition: str) -> Iterator[Judged]:
    if limits.p99_ratio is None or FULL_ALONE not in parts:
        return
    whole = [spread(parts[part].wakeup_latency_us) for part in (FULL, FULL_ALONE)]
    with_it, without = (
        median_of_slices(parts[part], "wakeup_latency_us", "p99") for part in (FULL, FULL_ALONE)
    )
    value = with_it / without if with_it is not None and without else None
    row = _row(
        "wake-up p99 of the median slice, recorder on / off",
        condition,
        value,
        limits.p99_ratio,
        "",
        _too_few("p99", *whole),
    )
    within = with_it is not None and without is not None and with_it <= without + limits.allowance_us
    if row.passed is False and within:
        row = Judged(
            row.name, condition, value, row.limit, "", True, f"less than {limits.allowance_us:g} us more"
        )
    yield row


PERCENTILE = {"p50": "p50", "p99": "p99", "p999": "p99.9", "max": "maximum"}
SHORT = {LOOP_PLAIN: "plain sleep", LOOP_SPIN: "sleep + spin", FULL: "control node"}


def _row(name: str, condition: str, value: float | None, limit: float, unit: str, why: str = "") -> Judged:
    if value is None and not why:
        why = "nothing was measured"
    return Judged(name, condition, value, limit, unit, None if why or value is None else value <= limit, why)


def _too_few(percentile: str, *spreads: Spread | None) -> str:
    fewest = min((known.count for known in spreads if known is not None), default=0)
    needed = NEEDED[percentile]
    return "" if fewest >= needed else f"{fewest} cycles are too few, {needed} needed"


def _spins(known: Measured) -> bool:
    return all(piece.rights.get("spin", {}).get("mode", "fixed") != "off" for piece in known.slices)
