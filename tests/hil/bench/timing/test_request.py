"""What may be asked for, and the order in which it is measured."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hil.bench.errors import ScenarioError
from hil.bench.timing.request import check, default_slices


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((0.0005, 60, None, "auto"), "--period"),
        ((float("nan"), 60, None, "auto"), "--period"),
        ((0.01, 0.1, None, "auto"), "--duration"),
        ((0.01, float("inf"), None, "auto"), "--duration"),
        ((0.01, 2.0, 30, "auto"), "--slices"),
        ((0.01, 2.0, None, "long"), "--spin"),
        ((0.001, 2.0, None, "600"), "--spin"),
        ((0.01, 2.0, None, "nan"), "--spin"),
    ],
)
def test_what_makes_no_measurement_is_refused_with_the_option(arguments, complaint):
    with pytest.raises(ScenarioError, match=complaint):
        check(*arguments)


def test_slices_are_short_and_there_are_several():
    assert default_slices(60.0) == 6
    assert default_slices(3600.0) == 360
    assert default_slices(5.0) == 3
    assert default_slices(0.5) == 1


def test_every_round_measures_every_part_and_the_order_changes(campaign):
    request = replace(campaign.request, slices=20)
    turns = request.turns("idle")
    assert all(sorted(turn) == sorted(request.parts) for turn in turns)
    assert len(set(turns)) > 5
    assert turns == request.turns("idle"), "the same seed gives the same order"
