"""The verdict in words, and every criterion as a row: value, limit, how much of the limit it takes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from hil.bench.report.source import RunSource

__all__ = [
    "MARGINAL",
    "CriterionRow",
    "criterion_rows",
    "figures",
    "headline",
    "number",
    "sentence",
    "signed",
    "words",
]

MARGINAL = 0.8
"""What takes this share of its limit and passes is marked: the next run, or the real train, may not."""

NAMES = {
    "rms_speed_error": "RMS speed error",
    "jerk": "Largest jerk",
    "e2e_rejected": "E2E rejected",
    "stop_error": "Stop error",
}
VERDICTS = {"passed": "Passed", "failed": "Failed", "aborted": "Aborted", "unknown": "No verdict"}


@dataclass(frozen=True)
class CriterionRow:
    """One criterion: `state` is passed, marginal, failed or unknown; `share` of the limit, None without."""

    name: str
    title: str
    value: float | None
    limit: float
    unit: str
    state: str
    share: float | None

    @property
    def word(self) -> str:
        """The state as the table says it."""
        return {"unknown": "failed: not reached or not known"}.get(self.state, self.state)


def criterion_rows(summary: Mapping[str, Any]) -> list[CriterionRow]:
    """The criteria of a summary in its order."""
    rows = []
    for row in summary.get("criteria", ()):
        value = None if row["value"] is None else float(row["value"])
        limit = float(row["limit"])
        share = abs(value) / limit if value is not None and limit > 0 else None
        state = "passed" if row["passed"] else "failed"
        if value is None:
            state = "unknown"
        elif row["passed"] and share is not None and share >= MARGINAL:
            state = "marginal"
        rows.append(
            CriterionRow(row["name"], words(row["name"]), value, limit, unit(row["unit"]), state, share)
        )
    return rows


def words(name: str) -> str:
    """A name of summary.json for people."""
    if name in NAMES:
        return NAMES[name]
    for start in ("deadline_misses_", "consecutive_misses_"):
        if name.startswith(start):
            return f"{start.replace('_', ' ').strip().capitalize()}, {name.removeprefix(start)}"
    return name.replace("_", " ").capitalize()


def unit(text: str) -> str:
    """A unit with proper signs."""
    return text.replace("^2", "²").replace("^3", "³")


def number(value: float | None, digits: int = 3) -> str:
    """A number in a table: three significant digits, whole numbers whole, a proper minus."""
    if value is None:
        return "–"
    whole = float(value).is_integer() or abs(value) >= 10**digits
    text = f"{value:.0f}" if whole else f"{value:#.{digits}g}".rstrip(".")
    if "e" in text:
        text = f"{value:.{digits}g}"
    return text.replace("-", "\u2212")


def signed(value: float | None) -> str:
    """A difference: with its sign, 0 without."""
    text = number(value)
    return f"+{text}" if value is not None and value > 0 else text


def headline(source: RunSource) -> str:
    """The verdict as one word (or two)."""
    return VERDICTS.get(source.verdict, source.verdict.capitalize())


def sentence(source: RunSource) -> str:
    """The verdict explained: what failed, what is marginal, how the run ended."""
    summary = source.summary
    if not summary:
        return "This run left no summary, so nothing was judged."
    rows = criterion_rows(summary)
    failed = [row.title for row in rows if row.state in {"failed", "unknown"}]
    marginal = [row.title for row in rows if row.state == "marginal"]
    parts = []
    if summary.get("ended") != "arrived":
        parts.append(f"The run did not arrive: {summary.get('ended_because', 'no reason is known')}.")
    if failed:
        parts.append(f"{len(failed)} of {len(rows)} criteria not met: {_listed(failed)}.")
    elif rows:
        parts.append(f"All {len(rows)} criteria are met.")
    if marginal:
        parts.append(f"Marginal, at {100 * MARGINAL:.0f}\u00a0% of the limit or more: {_listed(marginal)}.")
    return " ".join(parts)


def figures(summary: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """What people ask first: name, value with unit, what it is beside."""
    control = summary.get("control", {})
    found = []
    trip, allowed, error = (control.get(k) for k in ("trip_time_s", "allowed_time_s", "trip_time_error_s"))
    if trip is not None and allowed is not None:
        late = "" if error is None else f", {abs(error):.1f} s {'late' if error > 0 else 'early'}"
        found.append(("Trip time", f"{trip:.1f} s", f"allowed {allowed:.1f} s{late}"))
    stop = control.get("stop_error_m")
    if stop is not None:
        side = "past the stop point" if stop > 0 else "short of the stop point"
        found.append(("Stop error", _length(abs(stop)), side))
    rms = control.get("rms_speed_error_mps")
    if rms is not None:
        largest = control.get("max_speed_error_mps")
        found.append(
            (
                "RMS speed error",
                f"{rms * 3.6:.3f} km/h",
                f"largest {number(largest * 3.6)} km/h" if largest is not None else "",
            )
        )
    traction, back = control.get("traction_energy_j"), control.get("regenerated_energy_j")
    if traction is not None:
        beside = f"at the {control.get('energy_at', 'wheel rim')}"
        if back:
            beside += f"; {number(back / 3.6e6)} kWh braked electrically"
        found.append(("Traction energy", f"{number(traction / 3.6e6)} kWh", beside))
    return found


def _length(metres: float) -> str:
    if metres < 0.1:
        return f"{metres * 1000:.1f} mm"
    return f"{metres:.2f} m"


def _listed(names: Iterable[str]) -> str:
    *first, last = names
    joined = ", ".join(first)
    return f"{joined} and {last}" if joined else last
