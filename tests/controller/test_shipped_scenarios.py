"""The shipped timetables against the controller's own plan."""

import pytest

from controller.config import ControllerConfig
from controller.profile.plain import fastest_time_s
from hil.railway import load_journey
from hil.railway.library import list_scenarios


@pytest.mark.parametrize("path", [entry.path for entry in list_scenarios()], ids=lambda path: path.stem)
def test_every_shipped_timetable_can_be_kept_and_is_no_idle_run(path):
    config = ControllerConfig.load(path)
    journey = load_journey(path)
    minimum_s = fastest_time_s(journey, config.profile) + config.hold.release_s
    assert minimum_s <= journey.time_s <= 1.05 * minimum_s
