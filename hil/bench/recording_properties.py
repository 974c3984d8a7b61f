"""What a recording says of itself beside its signals: which run it is, what it is judged by, what is drawn.

Plain JSON: the recorder knows neither railway nor law.
"""

from __future__ import annotations

from typing import Any

from hil.bench.outcome import RunOptions
from hil.railway import Journey

__all__ = ["recording_properties", "track"]

SEEN_BEFORE_M, SEEN_BEYOND_M = 30.0, 60.0
"""How much of the line is drawn behind the train at its origin, and beyond the destination."""

US_PER_S = 1e6


def recording_properties(options: RunOptions) -> dict[str, Any]:
    """The properties of a run's recording."""
    scenario = options.scenario
    journey = scenario.journey
    properties: dict[str, Any] = {
        "scenario": scenario.name,
        "title": scenario.title,
        "law": scenario.law,
        "seed": journey.seed,
        "mode": options.mode,
        "line": journey.line.name,
        "train": journey.train.name,
        "origin_m": journey.origin.position_m,
        "destination_m": journey.destination.position_m,
        "timetable_s": journey.time_s,
        "track": track(journey),
        "limits": scenario.limits.model_dump(),
        "period_us": {
            "controller": scenario.controller_period_s * US_PER_S,
            "plant_sim": scenario.plant_period_s * US_PER_S,
        },
    }
    if options.bus.bitrate is not None:
        properties["bitrate"] = options.bus.bitrate
    draw = getattr(scenario.configurations["controller"], "law_picture", None)
    if draw is not None:  # a controller of the user's own may have nothing to show
        properties["law_picture"] = draw(journey.train)
    return properties


def track(journey: Journey) -> dict[str, Any]:
    """The part of the line that a run sees, for the recorder's drawing: m, m/s, permille."""
    line, length_m = journey.line, journey.train.length_m
    start_m = journey.origin.position_m - length_m - SEEN_BEFORE_M
    end_m = journey.destination.position_m + SEEN_BEYOND_M
    edges_m, limits_mps = line.speed_limit_profile()
    limits = zip(edges_m[:-1].tolist(), edges_m[1:].tolist(), limits_mps.tolist(), strict=True)

    def seen(start: float, end: float) -> bool:
        return end > start_m and start < end_m

    return {
        "start_m": start_m,
        "end_m": end_m,
        "train_length_m": length_m,
        "stops": [
            (stop.name, stop.position_m) for stop in line.stops if seen(stop.position_m, stop.position_m)
        ],
        "limits_mps": [list(row) for row in limits if seen(row[0], row[1])],
        "gradients_permille": [
            (g.start_m, g.end_m, g.permille) for g in line.gradients if seen(g.start_m, g.end_m)
        ],
        "curves_m": [(c.start_m, c.end_m, c.radius_m) for c in line.curves if seen(c.start_m, c.end_m)],
        "tunnels": [(t.start_m, t.end_m) for t in line.tunnels if seen(t.start_m, t.end_m)],
        "balises_m": [b.position_m for b in line.balises if seen(b.position_m, b.position_m)],
    }
