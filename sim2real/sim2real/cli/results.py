"""What commands of this package write: a contract violation, or result files in a folder."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim2real.wiring.fault import WiringFault

VIOLATION = 2  # exit status of a command whose input breaks its contract


def report_violation(violation: Exception) -> int:
    """Print a contract violation to stderr and as the last JSON object; the exit status."""
    print(f"contract violation: {violation}", file=sys.stderr)
    print(json.dumps({"error": f"contract violation: {violation}"}))
    return VIOLATION


def report_fault(fault: WiringFault, recording: Path, out: Path | None) -> int:
    """Print a wrong convention of a recording, as a sentence and as the last JSON object, and write it to wiring.json in a folder; the exit status."""
    found = {"verdict": "wiring", "recording": str(recording), **asdict(fault)}
    print(f"{recording}: {fault.sentence} {fault.remedy} Nothing else is diagnosed from this recording.")
    print(json.dumps(found))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "wiring.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return VIOLATION


def write_results(folder: Path, name: str, report: dict, render: Callable[[], str]) -> None:
    """Write NAME.json and NAME.html into a folder, which is made if needed."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    (folder / f"{name}.html").write_text(render(), encoding="utf-8")
