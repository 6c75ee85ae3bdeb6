"""The result of `diagnose` for the same arm, as a row of the report."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from sim2real.recordings.reading import ContractViolation


@dataclass(frozen=True)
class ArmResult:
    """The diagnosis of the arm."""

    verdict: str
    """As in report.json: no_gap, identified, ambiguous, partly_explained, unexplained."""
    sentence: str
    """The finding in words."""


def read_arm_result(folder: str | Path) -> ArmResult:
    """From the folder that `diagnose` wrote. Raises ContractViolation where its report is missing or incomplete."""
    path = Path(folder) / "report.json"
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        missing = [key for key in ("verdict", "sentence") if key not in report]
    except (OSError, ValueError, TypeError) as error:
        got = getattr(error, "strerror", None) or error
        raise ContractViolation(f"arm {path}: expected what `diagnose` wrote, got: {got}") from error
    if missing:
        raise ContractViolation(f"arm {path}: expected what `diagnose` wrote, got no {missing[0]}")
    return ArmResult(str(report["verdict"]), str(report["sentence"]))
