"""The other commands, as a user types them."""

import json

import pytest
from e2e_support import hil


def test_list_names_what_ships(tmp_path):
    done = hil("list", "--json", cwd=tmp_path)
    found = json.loads(done.stdout)
    assert "cat_linh_la_thanh" in found["scenarios"]
    assert "fuzzy_d_2km" in found["lines"]
    assert {"fuzzy_d", "pid"} <= set(found["laws"])
    assert "cat_linh_la_thanh" in hil("list", cwd=tmp_path).stdout


def test_doctor_says_what_is_there_and_how_to_get_the_rest(tmp_path):
    done = hil("doctor", "--json", cwd=tmp_path)
    findings = {row["what"]: row for row in json.loads(done.stdout)}
    assert findings["local bus"]["state"] == "yes"
    assert all(row["remedy"] for row in findings.values() if row["state"] == "no")
    assert "local bus" in hil("doctor", cwd=tmp_path).stdout


@pytest.mark.parametrize("command", [[], ["run"], ["list"], ["view"], ["doctor"]])
def test_help_is_there(command, tmp_path):
    done = hil(*command, "--help", cwd=tmp_path)
    assert done.returncode == 0
    assert "Usage" in done.stdout


def test_json_prints_one_document_and_nothing_else(run_hil, tmp_path):
    done = run_hil("--lockstep", "--json", "-i", "virtual", "-c", "json", bus=False)
    assert json.loads(done.stdout) == done.summary
