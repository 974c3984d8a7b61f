"""junit.xml: one test case per criterion, so that any CI server shows a run as tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree


def write_junit(summary: dict[str, Any], path: Path) -> None:
    """Write the criteria of `summary` (the content of summary.json) as a JUnit test suite."""
    rows = summary["criteria"]
    incomplete = summary["ended"] != "arrived"
    failures = sum(not row["passed"] for row in rows) + incomplete
    suite = ElementTree.Element(
        "testsuite",
        name=f"hil.{summary['scenario']}",
        tests=str(len(rows) + 1),
        failures=str(failures),
        time=f"{summary['wall_time_s']:.3f}",
        timestamp=summary["started"],
    )
    run = ElementTree.SubElement(suite, "testcase", classname=suite.get("name", ""), name="run_completed")
    if incomplete:
        ElementTree.SubElement(run, "failure", message=summary["ended_because"])
    for row in rows:
        case = ElementTree.SubElement(suite, "testcase", classname=suite.get("name", ""), name=row["name"])
        if not row["passed"]:
            ElementTree.SubElement(case, "failure", message=failure_text(row))
    ElementTree.indent(suite)
    ElementTree.ElementTree(suite).write(path, encoding="utf-8", xml_declaration=True)


def failure_text(row: dict[str, Any]) -> str:
    """One failed criterion in words."""
    if row["value"] is None:
        return f"{row['name']}: not reached (limit {row['limit']:g} {row['unit']})"
    return f"{row['name']}: {row['value']:.4g} {row['unit']} exceeds {row['limit']:g} {row['unit']}"
