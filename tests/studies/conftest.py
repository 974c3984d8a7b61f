"""Runs of the studies that several tests look at: each is made once."""

import pytest


@pytest.fixture(scope="session")
def fuzzy_d_study():
    from studies import fuzzy_d

    return fuzzy_d.run()


@pytest.fixture(scope="session")
def fsmc_study():
    from studies import fsmc

    return fsmc.run()


@pytest.fixture(scope="session")
def fuzzy_pid_study():
    from studies import fuzzy_pid

    return fuzzy_pid.run()


@pytest.fixture
def number():
    """Our number of a row, by group and quantity (both by their beginning)."""

    def find(study, group, quantity):
        found = [
            row for row in study.rows if row.group.startswith(group) and row.quantity.startswith(quantity)
        ]
        assert len(found) == 1, [row.quantity for row in found]
        return found[0].ours

    return find
