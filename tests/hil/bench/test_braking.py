"""How long a run goes on once its controller is gone."""

from hil.bench.braking import BRAKING_LIMIT_S, SETTLE_S, Cut
from hil.bench.watch import Ending, View

DIED = Ending("died", "controller: killed by signal 9 (SIGKILL)")


def at(time_s: float, *, standstill: bool) -> View:
    return View(time_s=time_s, standstill=standstill)


def test_first_sign_of_standstill_does_not_end_the_run_for_the_train_still_creeps():
    cut = Cut(DIED, since_s=10.0, interrupts=0)
    assert not cut.over(at(10.0, standstill=False), interrupts=0)
    assert not cut.over(at(20.0, standstill=True), interrupts=0)
    assert not cut.over(at(20.0 + 0.9 * SETTLE_S, standstill=True), interrupts=0)
    assert cut.over(at(20.1 + SETTLE_S, standstill=True), interrupts=0)


def test_wheel_that_turns_again_starts_the_wait_anew():
    cut = Cut(DIED, since_s=0.0, interrupts=0)
    assert not cut.over(at(1.0, standstill=True), interrupts=0)
    assert not cut.over(at(1.4, standstill=False), interrupts=0)
    assert not cut.over(at(1.6, standstill=True), interrupts=0)
    assert cut.over(at(1.7 + SETTLE_S, standstill=True), interrupts=0)


def test_train_that_never_stands_is_not_waited_for_without_end_and_the_user_may_cut_it_short():
    cut = Cut(DIED, since_s=5.0, interrupts=1)
    assert not cut.over(at(4.9 + BRAKING_LIMIT_S, standstill=False), interrupts=1)
    assert cut.over(at(5.1 + BRAKING_LIMIT_S, standstill=False), interrupts=1)
    assert Cut(DIED, since_s=5.0, interrupts=1).over(at(5.0, standstill=False), interrupts=2)
