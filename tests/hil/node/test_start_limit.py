"""How long a process may take to start."""

import pytest

from hil.node.options import OptionsError
from hil.node.start_limit import start_limit_s


def test_limit_is_a_minute_unless_the_environment_says_otherwise(monkeypatch):
    monkeypatch.delenv("HIL_START_TIMEOUT_S", raising=False)
    assert start_limit_s() == 60.0
    monkeypatch.setenv("HIL_START_TIMEOUT_S", "180")
    assert start_limit_s() == 180.0


@pytest.mark.parametrize("text", ["soon", "0", "-1", "nan", "inf"])
def test_limit_that_is_no_time_is_one_clear_line(monkeypatch, text):
    monkeypatch.setenv("HIL_START_TIMEOUT_S", text)
    with pytest.raises(OptionsError, match=f"HIL_START_TIMEOUT_S={text}: must be a number of seconds"):
        start_limit_s()
