"""A sealed set is begun only where the diagnosis reports on a case of the development set.

On a machine where it does not start, every case of a sealed set would end with an error, and the set be spent.
"""

from __future__ import annotations

import shutil
from dataclasses import replace

from np_blind.arm.evaluation.jobs import DiagnosisJob, diagnose_cases, report_path
from np_blind.arm.sampling.cases import draw_cases
from np_blind.sealed import SealError
from np_common.parallel import Workers

MOTIONS = ("sinusoid_2", "sinusoid_4", "triangle_fast")  # the diagnosis requires ten blocks of motion


def check_diagnosis_runs(which: str, seed: int, asking: DiagnosisJob, workers: Workers) -> None:
    """Record and diagnose the first case of the development set that belongs to a locked one, in a folder that is then removed.

    Raises SealError with what went wrong.
    """
    folder = asking.out / "rehearsal"
    shutil.rmtree(folder, ignore_errors=True)
    (case,) = draw_cases(1, seed, which.replace("locked", "development"))
    diagnose_cases([case], MOTIONS, replace(asking, out=folder, identify=""), 1, workers)
    error = (report_path(folder, case.number) / "error.txt").read_text()
    shutil.rmtree(folder)
    if error:
        raise SealError(f"expected a report on a development case before the sealed set is begun; {error}")
