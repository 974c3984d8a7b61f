"""What every test may use, and the honest account of what was skipped."""

from __future__ import annotations

import os
import uuid

import pytest

REQUIRE_ALL = os.environ.get("HIL_REQUIRE_ALL") == "1"


@pytest.fixture
def channel() -> str:
    """A name for a local bus that no other test uses."""
    return f"test-{uuid.uuid4().hex[:10]}"


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    """Where every test is required (CI), a skipped test is a failed one."""
    outcome = yield
    report = outcome.get_result()
    if REQUIRE_ALL and report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        report.outcome = "failed"
        report.longrepr = f"required here (HIL_REQUIRE_ALL=1), but skipped: {reason}"


def pytest_terminal_summary(terminalreporter):
    """Say last what was not tested, and the command that would enable it."""
    skipped = terminalreporter.stats.get("skipped", [])
    if not skipped:
        return
    terminalreporter.section("not tested on this machine", sep="=", yellow=True, bold=True)
    for report in skipped:
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        terminalreporter.line(f"{report.nodeid}: {reason.removeprefix('Skipped: ')}")
    terminalreporter.line("To enable them: make system-deps   (Debian packages; needs root), then make test")
