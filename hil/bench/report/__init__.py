"""The report of a run: `report.html`, one file that can be mailed, printed and read on a phone.

`write_report` makes it from a run directory, `write_comparison` puts several runs beside each other. Nothing
is loaded from a network, nothing runs in the browser: the pictures are SVG, the colours follow the reader's
theme.
"""

from __future__ import annotations

from hil.bench.report.comparison import COMPARISON_FILE, write_comparison
from hil.bench.report.page import REPORT_FILE, Written, write_report

__all__ = ["COMPARISON_FILE", "REPORT_FILE", "Written", "write_comparison", "write_report"]
