"""Where the host has no vcan0: the SocketCAN tests, run in a kernel that has one."""

import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

HERE = Path(__file__).parent


@pytest.mark.timeout(650)
def test_socketcan_tests_pass_in_a_kernel_with_vcan(in_guest, tmp_path):
    report = tmp_path / "guest.xml"
    output = in_guest(
        f"{sys.executable} -m pytest {HERE} -p no:cacheprovider -q --junitxml={report}"
        f" --basetemp={tmp_path / 'guest'} > {tmp_path / 'guest.log'} 2>&1"
    )
    log = (tmp_path / "guest.log").read_text() if (tmp_path / "guest.log").exists() else output
    assert report.exists(), f"the guest ran no tests: {log[-3000:]}"
    suite = ElementTree.parse(report).getroot().find("testsuite")
    counts = {key: int(suite.get(key)) for key in ("tests", "failures", "errors", "skipped")}
    print(log[-1500:])
    assert counts["tests"] >= 7, log[-3000:]
    assert (counts["failures"], counts["errors"], counts["skipped"]) == (0, 0, 0), log[-6000:]
