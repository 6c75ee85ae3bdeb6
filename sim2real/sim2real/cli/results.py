"""What commands of this package write: a contract violation, or result files in a folder."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

VIOLATION = 2  # exit status of a command whose input breaks its contract


def report_violation(violation: Exception) -> int:
    """Print a contract violation to stderr and as the last JSON object; the exit status."""
    print(f"contract violation: {violation}", file=sys.stderr)
    print(json.dumps({"error": f"contract violation: {violation}"}))
    return VIOLATION


def write_results(folder: Path, name: str, report: dict, render: Callable[[], str]) -> None:
    """Write NAME.json and NAME.html into a folder, which is made if needed."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    (folder / f"{name}.html").write_text(render(), encoding="utf-8")
