"""What commands of this package answer with: a refusal, or files in a folder."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

REFUSED = 2  # the exit status of a command that was given what breaks its contract


def report_violation(violation: Exception) -> int:
    """Say what broke the contract, to whoever reads and as the JSON object that is printed last; the exit status."""
    print(f"contract violation: {violation}", file=sys.stderr)
    print(json.dumps({"error": f"contract violation: {violation}"}))
    return REFUSED


def write_results(folder: Path, name: str, found: dict, draw: Callable[[], str]) -> None:
    """Write NAME.json and, once drawn, NAME.html into a folder, which is made where there is none."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (folder / f"{name}.html").write_text(draw(), encoding="utf-8")
