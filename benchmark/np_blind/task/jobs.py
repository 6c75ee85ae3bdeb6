"""Answers to the cases of the chain's blind set, case by case, on many processes. A case is a folder, done once its answer lies there."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from datetime import UTC, datetime
from pathlib import Path

from np_blind.repository import relative
from np_blind.task.cases import SET, Case
from np_common.cli import Progress
from np_common.files import write_atomically

NAME = "answer.json"  # of the doctor's answer to a case, in its folder
Answer = Callable[[Case, int], dict]
"""What a case of a set with such a seed is answered, and what is right about it."""


def answer(case: Case, seed: int) -> dict:
    """A case made, asked and judged."""
    from np_blind.task.evaluation import answer  # slow: no --help should wait for it

    return answer(case, seed)


def evaluate_case(case: Case, seed: int, out: Path, answer: Answer = answer, name: str = NAME) -> None:
    """Answer a case into its folder; what goes wrong is an answer too, and published. name: of the file, whoever answers."""
    try:
        row = answer(case, seed)
    except Exception:
        row = _error(case, relative(traceback.format_exc(limit=3)))
    kept = _kept(out, case, name)
    kept.parent.mkdir(exist_ok=True)
    write_atomically(kept, json.dumps(row, indent=1) + "\n")


def evaluate_cases(
    cases: Sequence[Case], seed: int, out: Path, pool: Executor, answer: Answer = answer, name: str = NAME
) -> list[dict]:
    """The answers to all cases, in their order; those that have none in `out` are asked for. name: as of `evaluate_case`.

    A case that lost the workers it was given to has an error in place of an answer, and no answer in `out`: the next call tries it again.
    """
    missing = [case for case in cases if not _kept(out, case, name).exists()]
    progress, lost = Progress(len(cases), "task"), {}
    progress.show(len(cases) - len(missing))
    asked = {pool.submit(evaluate_case, case, seed, out, answer, name): case for case in missing}
    for done, future in enumerate(as_completed(asked), len(cases) - len(missing) + 1):
        case = asked[future]
        if error := future.exception():
            lost[case.number] = _error(case, f"{type(error).__name__}: {error}")
        progress.show(done, f"case {case.number}")
    return [lost.get(c.number) or json.loads(_kept(out, c, name).read_text(encoding="utf-8")) for c in cases]


def publish(results: Path, command: str, seed: int, **found: object) -> None:
    """Write what was found of the set with a seed, with its date and the command that finds it again."""
    date = datetime.now(UTC).strftime("%Y-%m-%d")
    told = {"date": date, "command": f"python -m np_blind.{command}", "set": SET, "seed": seed, **found}
    write_atomically(results, json.dumps(told, indent=1) + "\n")


def _kept(out: Path, case: Case, name: str) -> Path:
    return out / f"case_{case.number:03d}" / name


def _error(case: Case, error: str) -> dict:
    return {"case": case.number, "kind": case.kind, "gap": case.gap, "error": error}
