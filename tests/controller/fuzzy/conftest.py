from __future__ import annotations

import pytest

from controller.fuzzy.membership import Trapezoid, left_shoulder, right_shoulder, triangle
from controller.fuzzy.rulebase import RuleBase
from controller.fuzzy.variable import Variable


@pytest.fixture(scope="session")
def odd_rules() -> RuleBase:
    """Everything that no law has: plateaus, an upright edge, three terms at once, a missing rule."""
    return RuleBase(
        error=Variable.shaped(
            "error",
            "m/s",
            (-1.0, 2.0),
            {
                "N": left_shoulder(-0.4, 1.0),
                "Z": Trapezoid(-0.6, -0.1, 0.3, 1.2),
                "P": right_shoulder(-0.5, 1.5),
            },
        ),
        rate=Variable.shaped(
            "rate",
            "m/s^2",
            (-1.0, 1.0),
            {"N": Trapezoid(-1.5, -1.2, 0.2, 0.2), "P": right_shoulder(-0.3, 0.1)},
        ),
        output=Variable.shaped(
            "output",
            "m/s^2",
            (-2.0, 3.0),
            {
                "N": triangle(-3.0, -2.0, -0.5),
                "Z": Trapezoid(-1.0, -1.0, 0.5, 0.8),
                "P": Trapezoid(-0.9, 0.0, 2.5, 4.0),
            },
        ),
        rules=(("N", "-", "P"), ("Z", "P", "P")),
    )
