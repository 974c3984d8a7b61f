"""Who takes part: what a user may write after --laws."""

import pytest

from hil.bench.contender import contenders
from hil.bench.errors import ScenarioError

LAWS = ("pid", "fuzzy_d", "smc")


def names(text):
    return [contender.name for contender in contenders(text, LAWS)]


def test_all_is_every_law_in_its_order():
    assert names("all") == ["pid", "fuzzy_d", "smc"]


def test_a_list_keeps_its_order_and_names_each_once():
    assert names("smc, pid,smc") == ["smc", "pid"]


def test_a_suffix_chooses_a_preset():
    (pid, paper) = contenders("pid,pid:paper", LAWS)
    assert (pid.preset, paper.preset) == (None, "paper")
    assert pid.overrides() == ('controller.law="pid"',)
    assert paper.overrides() == ('controller.law="pid"', 'controller.pid.preset="paper"')


def test_a_suffix_of_all_is_that_of_every_law():
    assert names("all,all:paper") == ["pid", "fuzzy_d", "smc", "pid:paper", "fuzzy_d:paper", "smc:paper"]


@pytest.mark.parametrize("text", ["lqr", "pid,lqr", "lqr:paper"])
def test_an_unknown_law_is_told_with_those_there_are(text):
    with pytest.raises(ScenarioError, match=r"no law 'lqr'; there are pid, fuzzy_d, smc \(or all\)"):
        contenders(text, LAWS)


def test_no_law_at_all_is_an_error():
    with pytest.raises(ScenarioError, match="name at least one law"):
        contenders(" , ", LAWS)
