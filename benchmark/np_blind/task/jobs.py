"""Evaluation of task cases on many processes. Each case has a folder and is done once its result lies there."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from datetime import UTC, datetime
from pathlib import Path

from np_blind.repository import relative
from np_blind.task.cases import SET, TaskCase
from np_common.cli import Progress
from np_common.files import write_atomically

NAME = "answer.json"  # of a case, in its folder
Answer = Callable[[TaskCase, int], dict]
"""Evaluates a case of a set with this seed: the diagnosis and its score."""


def answer(case: TaskCase, seed: int) -> dict:
    """Record, diagnose and score a case."""
    from np_blind.task.evaluation import answer  # slow: no --help should wait for it

    return answer(case, seed)


def evaluate_case(case: TaskCase, seed: int, out: Path, answer: Answer = answer) -> None:
    """Evaluate a case and write its result; an error is a result too."""
    try:
        row = answer(case, seed)
    except Exception:
        row = _error(case, relative(traceback.format_exc(limit=3)))
    kept = _answer_file(out, case)
    kept.parent.mkdir(exist_ok=True)
    write_atomically(kept, json.dumps(row, indent=1) + "\n")


def evaluate_cases(
    cases: Sequence[TaskCase], seed: int, out: Path, pool: Executor, answer: Answer = answer
) -> list[dict]:
    """The results of all cases, in their order; those without a result in `out` are evaluated.

    A case whose worker died has an error as its result and no file, so that the next call tries it again.
    """
    missing = [case for case in cases if not _answer_file(out, case).exists()]
    progress, lost = Progress(len(cases), "task"), {}
    progress.show(len(cases) - len(missing))
    asked = {pool.submit(evaluate_case, case, seed, out, answer): case for case in missing}
    for done, future in enumerate(as_completed(asked), len(cases) - len(missing) + 1):
        case = asked[future]
        if error := future.exception():
            lost[case.number] = _error(case, f"{type(error).__name__}: {error}")
        progress.show(done, f"case {case.number}")
    return [lost.get(c.number) or json.loads(_answer_file(out, c).read_text(encoding="utf-8")) for c in cases]


def publish(results: Path, command: str, seed: int, **found: object) -> None:
    """Write the results of a set with date and command."""
    date = datetime.now(UTC).strftime("%Y-%m-%d")
    published = {"date": date, "command": f"python -m np_blind.{command}", "set": SET, "seed": seed, **found}
    write_atomically(results, json.dumps(published, indent=1) + "\n")


def _answer_file(out: Path, case: TaskCase) -> Path:
    return out / f"case_{case.number:03d}" / NAME


def _error(case: TaskCase, error: str) -> dict:
    return {"case": case.number, "kind": case.kind, "gap": case.gap, "error": error}
