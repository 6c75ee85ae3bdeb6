"""Shrinks a failing run: fewer and shorter faults that still break the same guarantee."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from np_evaluation.simtest.plan import Plan, Report
from np_evaluation.simtest.run import Run


def play(plan: Plan) -> Report:
    """Run a plan in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        return Run(plan, Path(folder)).play()


def shrink(report: Report) -> Report:
    """Find a smaller run that breaks a guarantee which `report` breaks: omit each fault in turn, then halve each."""
    kinds, best = set(report.violations), report

    def keep(plan: Plan) -> bool:
        nonlocal best
        tried = play(plan)
        if kinds & set(tried.violations):
            best = tried
            return True
        return False

    number = 0
    while number < len(best.plan.faults):
        faults = best.plan.faults
        if not keep(replace(best.plan, faults=faults[:number] + faults[number + 1 :])):
            number += 1
    for number, fault in enumerate(best.plan.faults):
        shorter = replace(fault, seconds=fault.seconds / 2)
        faults = best.plan.faults
        if fault.seconds > 0.02:
            keep(replace(best.plan, faults=faults[:number] + (shorter,) + faults[number + 1 :]))
    return best
