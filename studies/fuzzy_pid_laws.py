"""The controllers of the fuzzy-PID study: fixed PID and fuzzy PID, with and without feed-forward."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

from controller.laws import Law, fuzzy_pid, pid

__all__ = ["DERIVATIVE_FILTER_PER_S", "Contender", "contenders"]


class Contender(NamedTuple):
    """One controller of the comparison. `base` names the fixed PID that it is measured by."""

    name: str
    title: str
    law: Law
    feed_forward: bool
    base: str
    gains: tuple[float, float, float]
    """kp [1/s], ki [1/s2], kd before the fuzzy part moves them."""


MODERATE = (0.6, 0.05, 0.1)
"""kp [1/s], ki [1/s2], kd: plausible hand tuning."""

TUNED = (0.646, 0.757, 0.943)
"""Least RMS error of a similar loop under a bound of the sensitivity of 1.8 (differential evolution).

In the loop of this study their sensitivity peaks higher; the table shows it.
"""

TUNED_WITH_FEED_FORWARD = (0.893, 0.147, 0.754)
"""The same with feed-forward."""

ERROR_RANGE_MPS, RATE_RANGE_MPS2 = 1.5, 0.6
DERIVATIVE_FILTER_PER_S = 10.0

Tables = Literal["textbook", "symmetric"]


def contenders() -> tuple[Contender, ...]:
    """All controllers, a fixed PID before the fuzzy ones on its gains."""
    found = []
    for base, title, gains, forward, share in (
        ("moderate", "moderate gains", MODERATE, False, 0.5),
        ("tuned", "tuned gains", TUNED, False, 0.1),
        ("forward", "tuned gains, feed-forward", TUNED_WITH_FEED_FORWARD, True, 0.1),
    ):
        found.append(Contender(base, f"PID, {title}", _pid(gains, forward), forward, base, gains))
        tables: tuple[Tables, ...] = ("textbook", "symmetric")
        for table in tables:
            law = _fuzzy(gains, share, table, forward)
            found.append(
                Contender(f"{base}_{table}", f"Fuzzy PID {table}, {title}", law, forward, base, gains)
            )
    return tuple(found)


def _pid(gains: tuple[float, float, float], forward: bool) -> Law:
    kp, ki, kd = gains
    return pid.Pid(pid.PidGains(kp, ki, kd, DERIVATIVE_FILTER_PER_S, feed_forward=forward))


def _fuzzy(gains: tuple[float, float, float], share: float, tables: Tables, forward: bool) -> Law:
    """Gains moved by at most this share of themselves, by tables over |e| <= 1.5 m/s, |de| <= 0.6 m/s2."""
    kp, ki, kd = gains
    return fuzzy_pid.FuzzyPid(
        replace(
            fuzzy_pid.PAPER,
            kp_per_s=kp,
            kp_range_per_s=share * kp,
            ki_per_s2=ki,
            ki_range_per_s2=share * ki,
            kd=kd,
            kd_range=share * kd,
            error_range_mps=ERROR_RANGE_MPS,
            rate_range_mps2=RATE_RANGE_MPS2,
            tables=tables,
            rate_filter_s=1.0 / DERIVATIVE_FILTER_PER_S,
            feed_forward=forward,
        )
    )
