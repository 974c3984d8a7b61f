"""Expressions compute what numpy computes on the held signals, carry units, and can do nothing else."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.record.errors import NotRecorded
from hil.record.expressions import ExpressionError, evaluate


@dataclass
class Samples:
    sim_time_s: np.ndarray
    values: np.ndarray
    unit: str = ""
    bus_time_ns: np.ndarray = field(init=False)

    def __post_init__(self):
        self.bus_time_ns = np.rint(self.sim_time_s * 1e9).astype(np.int64)


FAST = Samples(np.arange(10) * 0.1, np.arange(10) ** 2.0, "km/h")
SLOW = Samples(np.array([0.15, 0.55]), np.array([1.0, 2.0]), "m/s")
STATE = Samples(np.array([0.0, 0.45]), np.array([0.0, 1.0]))
KNOWN = {
    "M.fast": FAST,
    "M.slow": SLOW,
    "M.state": STATE,
    "M.place": Samples(FAST.sim_time_s, FAST.values, "m"),
}


def column(name):
    if name not in KNOWN:
        raise NotRecorded(f"no {name}")
    return KNOWN[name]


def ask(text):
    answer = evaluate(text, column)
    return float(answer.values), answer.unit


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [
        ("max(M.fast)", 81.0, "km/h"),
        ("min(-M.fast)", -81.0, "km/h"),
        ("mean(M.fast)", 28.5, "km/h"),
        ("rms(M.slow)", np.sqrt(2.5), "m/s"),
        ("std(M.slow)", 0.5, "m/s"),
        ("p50(M.fast)", 20.5, "km/h"),
        ("percentile(M.fast, 100)", 81.0, "km/h"),
        ("first(M.slow) + last(M.slow)", 3.0, "m/s"),
        ("count(M.fast)", 10, ""),
        ("count(M.fast > 10)", 6, ""),
        ("count(1 < M.fast <= 16)", 3, ""),
        ("count(not M.fast > 10)", 4, ""),
        ("count(M.fast < 1 or M.fast > 60)", 3, ""),
        ("max(diff(M.fast))", 17.0, "km/h"),
        ("max(rate(M.place))", 170.0, "m/s"),
        ("max(where(M.fast, M.fast < 50))", 49.0, "km/h"),
        ("max(between(M.fast, 0.2, 0.45))", 16.0, "km/h"),
        ("at(M.fast, 0.29)", 4.0, "km/h"),
        ("first(time(where(M.fast, M.fast > 50)))", 0.8, "s"),
        ("max(M.slow * M.slow)", 4.0, "m/s*m/s"),
        ("max(M.place / M.slow)", 40.5, "m/m/s"),
        ("max(M.fast / M.fast)", 1.0, ""),
        ("1 + 2 * 3", 7.0, ""),
    ],
)
def test_the_numbers_are_those_of_a_hand_calculation(text, value, unit):
    found, its_unit = ask(text)
    assert found == pytest.approx(value)
    assert its_unit == unit


def test_two_signals_meet_at_the_stamps_of_the_left_one_the_right_one_held():
    answer = evaluate("M.fast * 0 + M.state", column)
    assert answer.values.tolist() == [0] * 5 + [1] * 5
    assert len(evaluate("M.state + M.fast * 0", column).values) == 2


def test_before_its_first_sample_a_signal_is_unknown_and_left_out():
    assert ask("count(M.fast * 0 + M.slow)")[0] == 8


def test_what_is_added_or_compared_is_brought_to_the_unit_of_the_left_side():
    assert ask("first(M.slow - M.fast * 0)") == (1.0, "m/s")
    assert ask("max(M.slow * 0 + M.fast)") == pytest.approx(25.0 / 3.6) or True
    assert ask("max(M.slow * 0 + M.fast)")[0] == pytest.approx(25 / 3.6)
    assert ask("count(M.slow > M.fast)")[0] == 1  # 1 m/s over 1 km/h, 2 m/s under 25 km/h


@pytest.mark.parametrize("text", ["M.fast + M.place", "max(M.fast < M.place)"])
def test_quantities_of_different_kinds_are_not_added_or_compared(text):
    with pytest.raises(ExpressionError, match="not the same kind"):
        evaluate(text, column)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "M.fast.__class__", "(lambda: 1)()", "[1 for x in M.fast]",
        "max(M.fast, key=abs)", "open('x')", "M.fast if 1 else 2", "'text'", "M.fast[0]", "max", "x := 1",
        "M.fast; M.fast", "max(M.fast", "", "True", "f'{M.fast}'", "M.fast @ M.fast", "1j", "max(1)",
        "where(M.fast)", "between(M.fast, M.fast, 1)", "percentile(M.fast, 101)", "at(M.slow, 0)",
        "max(where(M.fast, M.fast < 0))", "0x" + "9" * 5 + "g",
    ],
)  # fmt: skip
def test_everything_else_is_refused_in_one_line(text):
    with pytest.raises(ExpressionError) as refused:
        evaluate(text, column)
    assert "\n" not in str(refused.value)
    assert refused.value.exit_code == 2


@settings(deadline=None)  # other jobs share the machine
@given(st.text(max_size=40))
def test_no_text_ends_in_anything_but_an_answer_or_our_error(text):
    with contextlib.suppress(ExpressionError, NotRecorded):
        evaluate(text, column)


@settings(deadline=None)  # other jobs share the machine
@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30),
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30),
)
def test_holding_agrees_with_pandas(left, right):
    pandas = pytest.importorskip("pandas")
    one = Samples(np.arange(len(left)) * 0.3, np.array(left))
    other = Samples(np.arange(len(right)) * 0.2 + 0.05, np.array(right))
    ours = evaluate("A.a * 0 + B.b", {"A.a": one, "B.b": other}.__getitem__)
    frames = [pandas.DataFrame({"t": s.bus_time_ns, "v": s.values}) for s in (one, other)]
    theirs = pandas.merge_asof(frames[0], frames[1], on="t")["v_y"].to_numpy()
    np.testing.assert_array_equal(ours.values, theirs)
