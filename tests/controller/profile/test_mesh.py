"""The mesh has its nodes where the track changes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.profile.mesh import SHORTEST_STAGE_M, mesh
from controller.profile.profile import ProfileError

PLACES = st.lists(st.floats(-50.0, 1050.0, allow_nan=False), max_size=12)


@given(PLACES, st.floats(1.0, 400.0))
def test_every_boundary_inside_is_a_node_and_no_step_is_too_long(places, step):
    nodes = mesh(0.0, 1000.0, places, step)
    assert nodes[0] == 0.0
    assert nodes[-1] == 1000.0
    assert np.all(np.diff(nodes) > 0.0)
    assert np.max(np.diff(nodes)) <= step * (1.0 + 1e-9)
    for place in places:
        if 0.0 < place < 1000.0:
            assert np.min(np.abs(nodes - place)) <= SHORTEST_STAGE_M


def test_an_even_division_has_no_step_too_many():
    assert len(mesh(0.0, 931.0, [], 9.31)) == 101


@pytest.mark.parametrize(("start", "end", "step"), [(1.0, 1.0, 5.0), (2.0, 1.0, 5.0), (0.0, 1.0, 0.0)])
def test_an_empty_route_or_step_is_refused(start, end, step):
    with pytest.raises(ProfileError):
        mesh(start, end, [], step)


def test_a_step_that_would_fill_the_memory_is_refused():
    with pytest.raises(ProfileError, match=r"1e-09 must be at least 0\.000931"):
        mesh(0.0, 931.0, (), 1e-9)
