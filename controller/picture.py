"""What the inside of a law looks like, for whoever draws it: its rule bases as arrays, its probes as charts.

Plain values only, so that they can be written into a recording. Made once before a run; the law itself knows
nothing of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from controller.config import ControllerConfig
from controller.fuzzy.bases import fsmc_rules, fuzzy_d_rules, fuzzy_pid_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.fuzzy.rulebase import RuleBase
from controller.fuzzy.variable import Variable
from controller.laws import Drive
from controller.laws.selection import LAWS

__all__ = ["law_picture"]

PROCESS = "controller"
POINTS = 61
KMH_PER_MPS = 3.6
SHARES = (
    ("feed_forward_mps2", "feed-forward"),
    ("feedback_mps2", "feedback"),
    ("integral_mps2", "integral"),
)

Picture = dict[str, Any]


def law_picture(config: ControllerConfig, drive: Drive) -> Picture:
    """Title, charts and surfaces of the configured law for a train with this drive: JSON types.

    A chart has `title`, `unit`, `lines` of (probe, name) and `levels` of (name, value, also at minus it). A
    surface has its two inputs (`probe` times `scale`, `terms`, `corners` of each, universe), `rules` by rate
    and error term, and `values` (61 x 61) evenly over both.
    """
    made = PICTURES.get(config.law, _plain)(config, drive)
    return {"process": PROCESS, "title": LAWS[config.law].title, "charts": made[0], "surfaces": made[1]}


Made = tuple[list[Picture], list[Picture]]


def _plain(config: ControllerConfig, drive: Drive) -> Made:
    """Of a law that says nothing of its inside but its probes."""
    return [_error_chart()], []


def _pid(config: ControllerConfig, drive: Drive) -> Made:
    return [_error_chart(), _chart("Shares of the demand", "m/s^2", SHARES)], []


def _speedt(config: ControllerConfig, drive: Drive) -> Made:
    p = config.speedt.parameters()
    rules = fuzzy_d_rules(p.error_peaks_mps, p.rate_peaks_mps2, p.output_peaks_mps2)
    shares = (("feed_forward_mps2", "feed-forward"), ("fuzzy_output_mps2", "output of the rules"))
    return _fuzzy_charts(shares), [_surface("Demand", rules)]


def _fuzzy_d(config: ControllerConfig, drive: Drive) -> Made:
    p = config.fuzzy_d.parameters()
    rules = fuzzy_d_rules(p.error_peaks_mps, p.rate_peaks_mps2, p.output_peaks_mps2)
    return _fuzzy_charts(SHARES), [_surface("Demand", rules)]


def _fuzzy_pid(config: ControllerConfig, drive: Drive) -> Made:
    p = config.fuzzy_pid.parameters()
    rules = fuzzy_pid_rules(p.error_range_mps, p.rate_range_mps2, tables=p.tables)
    gains = [
        _chart("Gain kp", "1/s", [("kp_per_s", "kp")], [("unchanged", p.kp_per_s, False)]),
        _chart("Gain ki", "1/s^2", [("ki_per_s2", "ki")], [("unchanged", p.ki_per_s2, False)]),
        _chart("Gain kd", "1", [("kd", "kd")], [("unchanged", p.kd, False)]),
    ]
    surfaces = [_surface(f"Change of {gain}", base) for gain, base in zip(rules._fields, rules, strict=True)]
    return [*_fuzzy_charts(SHARES), *gains], surfaces


def _smc(config: ControllerConfig, drive: Drive) -> Made:
    p = config.smc.parameters()
    layer = [("boundary layer", p.boundary_layer_mps, True)] if p.boundary_layer_mps > 0.0 else []
    charts = [
        _chart(
            "Sliding variable s: measured minus reference speed", "m/s", [("sliding_surface_mps", "s")], layer
        ),
        _chart(
            "Shares of the demand",
            "m/s^2",
            [("feed_forward_mps2", "feed-forward"), ("sliding_gain_mps2", "gain of the switching term")],
        ),
    ]
    return charts, []


def _fsmc(config: ControllerConfig, drive: Drive) -> Made:
    p = config.fsmc.parameters()
    scale = KMH_PER_MPS if p.s_input_unit == "km/h" else 1.0
    rules = fsmc_rules(p.half_range_s, p.half_range_rate_mps2)
    charts = _sliding_charts(p.half_range_s / scale, p.half_range_rate_mps2)
    surface = _surface("Output", rules, "sliding_surface_mps", "surface_rate_mps2", scale)
    if scale != 1.0:
        surface["error"]["unit"] = "km/h"
    return charts, [surface]


def _fsmc_eso(config: ControllerConfig, drive: Drive) -> Made:
    p = config.fsmc_eso.parameters()
    half_range = p.tuning(drive).half_range_s_mps
    rules = fsmc_rules(half_range, p.half_range_rate_mps2)
    observer = [
        _chart(
            "Observer: speed",
            "m/s",
            [("measured_speed_mps", "measured"), ("estimated_speed_mps", "estimated")],
        ),
        _chart(
            "Observer: acceleration that its model does not explain",
            "m/s^2",
            [("unmodelled_mps2", "unmodelled")],
            [("held within", p.unmodelled_limit_mps2, True)],
        ),
    ]
    charts = [*_sliding_charts(half_range, p.half_range_rate_mps2), *observer]
    return charts, [_surface("Output", rules, "sliding_surface_mps", "surface_rate_mps2")]


PICTURES: Mapping[str, Callable[[ControllerConfig, Drive], Made]] = MappingProxyType(
    {
        "pid": _pid,
        "speedt": _speedt,
        "fuzzy_d": _fuzzy_d,
        "fuzzy_pid": _fuzzy_pid,
        "smc": _smc,
        "fsmc": _fsmc,
        "fsmc_eso": _fsmc_eso,
    }
)


def _error_chart() -> Picture:
    return _chart("Speed error", "m/s", [("speed_error_mps", "speed error")])


def _fuzzy_charts(shares: Sequence[tuple[str, str]]) -> list[Picture]:
    return [
        _error_chart(),
        _chart("Its rate, as the rules see it", "m/s^2", [("error_rate_mps2", "error rate")]),
        _chart("Shares of the demand", "m/s^2", shares),
    ]


def _sliding_charts(half_range_mps: float, half_range_rate_mps2: float) -> list[Picture]:
    return [
        _chart(
            "Sliding variable s",
            "m/s",
            [("sliding_surface_mps", "s")],
            [("end of the rules' universe", half_range_mps, True)],
        ),
        _chart("Its rate", "m/s^2", [("surface_rate_mps2", "rate of s")]),
        _chart("Output of the rules", "1", [("fuzzy_output", "output")]),
        _chart("Feed-forward", "m/s^2", [("feed_forward_mps2", "feed-forward")]),
    ]


def _chart(
    title: str,
    unit: str,
    lines: Sequence[tuple[str, str]],
    levels: Sequence[tuple[str, float, bool]] = (),
) -> Picture:
    return {
        "title": title,
        "unit": unit,
        "lines": [list(line) for line in lines],
        "levels": [list(level) for level in levels],
    }


def _surface(
    name: str,
    rules: RuleBase,
    error_probe: str = "speed_error_mps",
    rate_probe: str = "error_rate_mps2",
    scale: float = 1.0,
) -> Picture:
    errors = np.linspace(rules.error.low, rules.error.high, POINTS)
    rates = np.linspace(rules.rate.low, rules.rate.high, POINTS)
    values = CompiledRuleBase(rules).array(errors[None, :], rates[:, None])
    return {
        "name": name,
        "unit": rules.output.unit,
        "error": {**_axis(rules.error, error_probe), "scale": scale},
        "rate": _axis(rules.rate, rate_probe),
        "rules": [list(row) for row in rules.rules],
        "product": rules.conjunction == "product",
        "values": [[float(f"{value:.4g}") for value in row] for row in values.tolist()],
    }


def _axis(variable: Variable, probe: str) -> Picture:
    return {
        "name": variable.name,
        "unit": variable.unit,
        "probe": probe,
        "terms": list(variable.terms),
        "corners": [list(variable.corners(term)) for term in variable.terms],
        "low": variable.low,
        "high": variable.high,
    }
