"""Bags and the reports of the diagnosis on them, case by case, on many processes.

A case that crashes, or takes too long, has an error instead of a report; the others go on. A case is done once its
folder holds error.txt (empty where all went well), so that a run goes on where it was cut off.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import traceback
from collections.abc import Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass
from pathlib import Path

from np_blind.arm.evaluation import baselines as others
from np_blind.arm.evaluation.follow_up import follow_up
from np_blind.arm.generate import bag_path, batches, make_bags, recording_path, reference_path
from np_blind.arm.sampling import six_hinges
from np_blind.arm.sampling.cases import ArmCase
from np_blind.repository import relative
from np_common.cli import Progress
from np_common.parallel import SINGLE_THREAD, Workers
from np_common.parent_process import end_with_parent


@dataclass(frozen=True)
class DiagnosisJob:
    """How the diagnosis is run."""

    out: Path
    """Folder of the run."""
    diagnosis: str
    """Command of the diagnosis."""
    timeout: float
    """Time limit s of one diagnosis."""
    keep: bool = False
    """Whether bags are kept."""
    identify: str = ""
    """Command of the baselines; empty for none."""


def report_path(out: Path, number: int) -> Path:
    """Folder of the report on a case; it holds error.txt once the diagnosis has run."""
    return out / "reports" / f"case_{number:03d}"


def is_diagnosed(out: Path, number: int) -> bool:
    """Whether a case is done, rightly or wrongly."""
    return (report_path(out, number) / "error.txt").exists()


def write_error(out: Path, number: int, error: str) -> None:
    """Put down that a case is done, and what went wrong."""
    folder = report_path(out, number)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "error.txt").write_text(relative(error))


def diagnose_cases(
    cases: Sequence[ArmCase], only: Sequence[str], asking: DiagnosisJob, jobs: int, workers: Workers
) -> None:
    """Bags and reports of all cases that have none yet. workers(jobs) gives an executor.

    A case that has lost every process it was given to (killed for its memory, for example) counts as failed.
    """
    with workers(jobs) as pool:
        _answer(cases, only, asking, jobs, pool)


def _answer(cases: Sequence[ArmCase], only: Sequence[str], asking: DiagnosisJob, jobs: int, pool) -> None:
    out = asking.out
    answered = {c.number for c in cases if is_diagnosed(out, c.number)}
    recorded = {c.number for c in cases if _is_recorded(out, c)} - answered
    missing = [c for c in cases if c.number not in answered | recorded]
    for case in missing:  # cut off while it was written
        _remove_bags(out, case.number)
    by_number = {c.number: c for c in cases}
    making = {pool.submit(_record, batch, only, asking): batch for batch in batches(missing, jobs)} if missing else {}
    answers: dict[Future, int] = {pool.submit(diagnose_case, by_number[n], asking): n for n in sorted(recorded)}
    bar, done = Progress(len(cases), "blind"), len(answered)
    bar.show(done, "simulating")
    while making:
        for future in as_completed([*making]):
            batch, lost = making.pop(future), _lost(future)
            if lost and len(batch) > 1:  # by one of them, and which it was shows where each is alone
                making |= {pool.submit(_record, [case], only, asking): [case] for case in batch}
                continue
            for number, error in ({batch[0].number: lost} if lost else future.result()).items():
                if error:  # counted as wrong: no report
                    write_error(out, number, error)
                    done += 1
                else:
                    answers[pool.submit(diagnose_case, by_number[number], asking)] = number
    for future in as_completed(answers):
        if lost := _lost(future):
            write_error(out, answers[future], lost)
        done += 1
        bar.show(done, "diagnosed")


def _lost(future: Future) -> str:
    """How a case lost the processes it was given to; "" where it did not."""
    error = future.exception()
    return f"{type(error).__name__}: {error}" if error else ""


def _is_recorded(out: Path, case: ArmCase) -> bool:
    paths = [bag_path(out, case.number), *([reference_path(out, case.number)] if case.day else [])]
    return all(recording_path(path).exists() for path in paths)


def _record(cases: Sequence[ArmCase], only: Sequence[str], asking: DiagnosisJob) -> dict[int, str]:
    """`make_bags`, case by case where one of them breaks it."""
    try:
        return make_bags(cases, only, asking.out)
    except Exception:  # whatever it is: it is the result of the case that it belongs to
        for case in cases:
            _remove_bags(asking.out, case.number)
        if len(cases) == 1:
            return {cases[0].number: f"no recording: {traceback.format_exc()[-2000:]}"}
        return {n: error for case in cases for n, error in _record([case], only, asking).items()}


def diagnose_case(case: ArmCase, asking: DiagnosisJob) -> None:
    """Run the diagnosis, and the baselines where requested, on the bag of a case; their reports go to
    reports/case_*."""
    try:
        error = _run_diagnosis(case, asking)
    except Exception:
        error = traceback.format_exc()[-2000:]
    write_error(asking.out, case.number, error.replace(f"{asking.out.resolve()}/", ""))  # which means nothing elsewhere
    if not asking.keep:
        _remove_bags(asking.out, case.number)


def _remove_bags(out: Path, number: int) -> None:
    for path in (bag_path(out, number), reference_path(out, number)):
        shutil.rmtree(path, ignore_errors=True)


def _run_diagnosis(case: ArmCase, asking: DiagnosisJob) -> str:
    """What went wrong."""
    bag, folder = bag_path(asking.out, case.number), report_path(asking.out, case.number)
    folder.mkdir(parents=True, exist_ok=True)
    further = (
        ["--reference", str(recording_path(reference_path(asking.out, case.number)).resolve())] if case.day else []
    )
    further += ["--model", str(six_hinges.MODEL)] if case.has_six_hinges else []

    def ask(bags: Sequence[Path], into: Path) -> str:
        command = [
            *shlex.split(asking.diagnosis),
            *(str(b.resolve()) for b in bags),
            *further,
            "--out",
            str(into.resolve()),
        ]
        try:
            done = subprocess.run(
                command,
                capture_output=True,
                text=True,
                timeout=asking.timeout,
                preexec_fn=end_with_parent,
                env={**os.environ, **SINGLE_THREAD},
            )
        except subprocess.TimeoutExpired:
            return f"no answer within {asking.timeout:g} s"
        return "" if done.returncode == 0 else f"status {done.returncode}: {(done.stdout + done.stderr)[-2000:]}"

    error = ask([recording_path(bag)], folder)
    if not error and not case.day:
        follow_up(case, bag, folder, ask)
    if asking.identify:
        others.identify(bag, folder, asking.identify, asking.timeout)
    return error
