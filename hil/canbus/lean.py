"""What a node process does not load: python-can's MF4 files, which bring asammdf and pandas with them.

A node writes no logs. The two would take most of a second of its start and stay in its locked memory.
"""

from __future__ import annotations

import sys

__all__ = ["leave_out_log_files"]


def leave_out_log_files() -> None:
    """Make `import asammdf` fail in this process, as if it were not installed; python-can is ready for that.

    To be called before `can` is imported first; what has been imported already stays.
    """
    if "can" not in sys.modules and "asammdf" not in sys.modules:
        sys.modules["asammdf"] = None  # type: ignore[assignment]  # how Python says "not to be imported"
