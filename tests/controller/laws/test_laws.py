"""What every law must hold, and what each one is."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controller.config import ControllerConfig
from controller.laws import (
    Measurement,
    Reference,
    carried_over,
    fsmc,
    fsmc_eso,
    fuzzy_d,
    fuzzy_pid,
    pid,
    smc,
    speedt,
)
from controller.laws.fuzzy_d import FuzzyD, FuzzyDParameters
from controller.laws.pid import PAPER_ON_TRAIN, Pid, PidGains
from controller.laws.selection import LAWS as SELECTION

DT = 0.01
MAKERS = {
    "pid": lambda: Pid(PidGains()),
    "speedt": lambda: speedt.SpeedT(speedt.SpeedTParameters()),
    "fuzzy_d": lambda: FuzzyD(FuzzyDParameters()),
    "fuzzy_pid": lambda: fuzzy_pid.FuzzyPid(fuzzy_pid.FuzzyPidParameters()),
    "smc": lambda: smc.Smc(smc.SmcParameters()),
    "fsmc": lambda: fsmc.Fsmc(fsmc.FsmcParameters()),
    "fsmc_eso": lambda: fsmc_eso.FsmcEso(fsmc_eso.FsmcEsoParameters()),
}
PAPER_MAKERS = {
    "pid": lambda: Pid(pid.PAPER),
    "speedt": lambda: speedt.SpeedT(speedt.PAPER),
    "fuzzy_d": lambda: FuzzyD(fuzzy_d.PAPER),
    "smc": lambda: smc.Smc(smc.PAPER),
    "fsmc": lambda: fsmc.Fsmc(fsmc.PAPER),
    "fsmc_eso": lambda: fsmc_eso.FsmcEso(fsmc_eso.PAPER),
}


def every(names, makers=MAKERS):
    return pytest.mark.parametrize("make", [makers[name] for name in names], ids=list(names))


each_law = every(MAKERS)
with_integral = every(["pid", "fuzzy_d", "fuzzy_pid"])
without_static_error = every(["pid", "fuzzy_d", "fuzzy_pid", "fsmc_eso"])
speeds = st.floats(-5, 40)
accelerations = st.floats(-2, 2)


def reference(speed=10.0, acceleration=0.0, preview=0.0):
    return Reference(0.0, speed, acceleration, preview)


def measured(speed=10.0, lowest=-1.3, highest=1.0):
    return Measurement(0.0, speed, lowest, highest)


@every([name for name in MAKERS if name != "fsmc_eso"])  # whose observer wants to see its demand's effect
def test_on_the_plan_the_demand_is_the_feed_forward(make):
    law = make()
    for _ in range(100):
        demand = law.step(reference(preview=-0.4), measured(), DT)
    assert demand == pytest.approx(-0.4, abs=1e-12)


@each_law
def test_a_slow_train_is_accelerated_and_a_fast_one_braked(make):
    slow, fast = make(), make()
    for _ in range(5):
        faster, slower = (
            slow.step(reference(10.0), measured(9.5), DT),
            fast.step(reference(10.0), measured(10.5), DT),
        )
    assert faster > 0.1
    assert slower < -0.1


@each_law
@given(steps=st.lists(st.tuples(speeds, speeds, accelerations, accelerations), min_size=1, max_size=30))
def test_the_demand_is_finite_and_within_what_the_train_can_do(make, steps):
    law = make()
    for planned, actual, acceleration, preview in steps:
        demand = law.step(reference(planned, acceleration, preview), measured(actual), DT)
        assert -1.3 <= demand <= 1.0
        assert all(math.isfinite(value) for value in law.internals())


@without_static_error
def test_a_static_error_is_integrated_away(make):
    law = make()
    speed = 10.0
    for _ in range(6000):
        speed += DT * (law.step(reference(), measured(speed), DT) - 0.2)
    assert speed == pytest.approx(10.0, abs=0.005)


@with_integral
def test_saturation_does_not_wind_up(make):
    law = make()
    for _ in range(3000):  # half a minute of full traction that does not suffice
        assert law.step(reference(20.0), measured(10.0), DT) == 1.0
    names = [name for name, _ in law.probe_names]
    assert abs(law.internals()[names.index("integral_mps2")]) < 0.05


@each_law
def test_saturated_traction_is_left_as_soon_as_the_error_reverses(make):
    law = make()
    for _ in range(3000):
        law.step(reference(20.0), measured(10.0), DT)
    for _ in range(150):
        demand = law.step(reference(20.0), measured(20.5), DT)
    assert demand < 0.0


@each_law
def test_reset_forgets_everything(make):
    used, fresh = make(), make()
    for k in range(50):
        used.step(reference(10.0), measured(9.0 + 0.01 * k), DT)
    used.reset()
    for k in range(20):
        arguments = reference(12.0, 0.1, 0.2), measured(11.0 + 0.02 * k), DT
        assert used.step(*arguments) == fresh.step(*arguments)


@each_law
def test_internals_have_the_names_they_are_announced_with(make):
    law = make()
    law.step(reference(), measured(9.9), DT)
    names = [name for name, _ in law.probe_names]
    assert len(set(names)) == len(law.internals())
    assert "feed_forward_mps2" in names


@with_integral
def test_feed_forward_and_feedback_add_up_to_the_demand(make):
    law = make()
    law.step(reference(10.0, preview=0.1), measured(9.9), DT)
    before = law.internals()[1]
    demand = law.step(reference(10.0, preview=0.1), measured(9.9), DT)
    feedback, _, feed_forward, *_ = law.internals()
    assert demand == pytest.approx(feedback + before + feed_forward, abs=1e-12)


def test_pid_follows_its_difference_equation():
    gains = PidGains(kp_per_s=2.0, ki_per_s2=0.3, kd=0.5, derivative_filter_per_s=4.0)
    law = Pid(gains)
    integral, state = 0.0, None
    for k in range(200):
        error = 0.2 * math.sin(0.05 * k)
        state = 0.5 * error if state is None else state
        derivative = 4.0 * (0.5 * error - state)
        expected = 2.0 * error + integral + derivative
        assert law.step(reference(10.0), measured(10.0 - error), DT) == pytest.approx(expected, abs=1e-9)
        integral += 0.3 * error * DT
        state += derivative * DT


def test_paper_gains_are_the_papers_in_acceleration_units():
    # Fuzzy-D paper: kp 2.774, ki 0.214, kd 4.088; DC force to acceleration 612 / 0.34 / 8621.
    unit = 612 / 0.34 / 8621
    assert pytest.approx(2.774 * unit, abs=5e-4) == PAPER_ON_TRAIN.kp_per_s
    assert pytest.approx(0.214 * unit, abs=5e-5) == PAPER_ON_TRAIN.ki_per_s2
    assert pytest.approx(4.088 * unit, abs=5e-4) == PAPER_ON_TRAIN.kd


def test_fuzzy_d_without_integral_is_the_papers_law():
    parameters = FuzzyDParameters(
        gain=10.0, derivative_gain=0.05, integral_gain_per_s2=0.0, rate_filter_s=0.0
    )
    law = FuzzyD(parameters)
    law.step(reference(10.0), measured(9.99), DT)
    demand = law.step(
        reference(10.0, 0.1),
        measured(9.991),
        DT,
    )
    *_, rate, output = law.internals()
    assert rate == pytest.approx(0.1 - 0.001 / DT)
    assert demand == pytest.approx(10.0 * output + 0.05 * rate, abs=1e-9)


@each_law
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("where", ["speed", "reference", "acceleration", "preview", "resistance"])
def test_a_value_that_is_no_number_is_refused_and_leaves_no_trace(make, bad, where):
    law, fresh = make(), make()
    wanted = Reference(
        0.0,
        bad if where == "reference" else 10.0,
        bad if where == "acceleration" else 0.0,
        bad if where == "preview" else 0.0,
    )
    seen = Measurement(
        0.0, bad if where == "speed" else 9.9, -1.3, 1.0, bad if where == "resistance" else 0.05
    )
    with pytest.raises(ValueError, match="not finite"):
        law.step(wanted, seen, DT)
    assert law.step(reference(), measured(9.9), DT) == fresh.step(reference(), measured(9.9), DT)


@every(PAPER_MAKERS, PAPER_MAKERS)
@settings(deadline=None, max_examples=50)
@given(steps=st.lists(st.tuples(st.floats(-20, 20), accelerations), min_size=1, max_size=20))
def test_papers_forms_are_odd_and_unlimited(make, steps):
    """What a law does to errors it does mirrored to mirrored ones; smc's gain needs level track for that."""
    law, mirrored = make(), make()
    for error, acceleration in steps:
        up = law.step(reference(0.0, acceleration, acceleration), free(-error), DT)
        down = mirrored.step(reference(0.0, -acceleration, -acceleration), free(error), DT)
        assert up == pytest.approx(-down, abs=1e-9 * max(1.0, abs(up)))


@every(["speedt", "fuzzy_d", "smc", "fsmc", "fsmc_eso", "fuzzy_pid", "pid"])
@settings(deadline=None, max_examples=50)
@given(steps=st.lists(st.tuples(st.floats(-3, 3), accelerations), min_size=1, max_size=20))
def test_trains_forms_are_odd(make, steps):
    law, mirrored = make(), make()
    for error, acceleration in steps:
        up = law.step(reference(0.0, acceleration, acceleration), free(-error), DT)
        down = mirrored.step(reference(0.0, -acceleration, -acceleration), free(error), DT)
        assert up == pytest.approx(-down, abs=1e-9 * max(1.0, abs(up)))


def free(speed):
    return Measurement(0.0, speed, -math.inf, math.inf)


@each_law
def test_a_step_allocates_nothing_that_grows(make):
    law = make()

    def counted():
        return sum(len(value) for value in vars(law).values() if isinstance(value, list | tuple | dict))

    for k in range(30):
        law.step(reference(10.0), measured(10.0 + 0.1 * math.sin(0.1 * k)), DT)
    before = counted()
    for k in range(3000):
        law.step(reference(10.0), measured(10.0 + 0.1 * math.sin(0.1 * k)), DT)
    assert counted() == before


def test_every_law_of_the_bus_contract_can_be_chosen_and_has_both_presets():
    numbers = {entry.number: name for name, entry in SELECTION.items()}
    assert numbers == {
        1: "pid", 2: "speedt", 3: "fuzzy_d", 4: "fuzzy_pid", 5: "smc", 6: "fsmc", 7: "fsmc_eso",
    }  # fmt: skip
    for name, entry in SELECTION.items():
        for preset in ("train", "paper"):
            config = ControllerConfig.model_validate({"law": name, name: {"preset": preset}})
            demand = entry.make(config).step(reference(), measured(9.8), DT)
            assert 0.0 < demand <= 1.0


def test_the_integral_shrinks_with_the_demand_and_never_grows():
    assert carried_over(-0.3, -0.9, -0.45) == pytest.approx(-0.15)
    assert carried_over(-0.3, -0.45, -0.9) == -0.3
    assert carried_over(0.2, 0.05, 0.0) == 0.2
    assert carried_over(0.2, 0.4, 0.0) == pytest.approx(0.05)
