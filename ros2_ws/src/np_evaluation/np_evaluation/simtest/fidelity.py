"""Runs one script in the simulation and over DDS, and reports where the outcomes differ."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from np_description.phases import FAULT
from np_evaluation.simtest.over_dds import DdsRun, select_playable
from np_evaluation.simtest.plan import Plan, Report
from np_evaluation.simtest.shrink import play

_LONGER = 5.0  # s added to simulated runs, since a call to a starting node may have delayed the end
_SHIFT = 0.3  # s, largest change of a fault's time in the last simulated run
_PLANNING = 190.0  # ms, longest time of a plan on a quiet machine (docs/results/bench.md)
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")


def find_outcome(report: Report) -> dict[str, set[str]]:
    """Extract guarantees broken, phases reached, faults raised and reasons of refusals by node; numbers are masked."""
    return {
        "broken": set(report.violations),
        "phases": {phase.partition(":")[0] for phase in report.phases},
        "faults": {_NUMBER.sub("#", phase) for phase in report.phases if phase.startswith(FAULT)},
        "refusals": {key for key, count in report.refusals.items() if ": refused_" in key and count},
    }


def find_differences(
    real: Mapping[str, set[str]],
    simulated: Sequence[Mapping[str, set[str]]],
    incomplete: Collection[str] = (),
    usual: Collection[str] = (),
) -> dict[str, dict[str, list[str]]]:
    """Find what only the run over DDS had, and what all simulated runs had but it had not; keys without a difference are left out.

    incomplete: nodes whose counts are not all known over DDS; usual: refusals of a simulated run without faults.
    """
    found = {}
    for key, seen in real.items():
        missing = set.intersection(*(each[key] for each in simulated)) - seen.union(usual)
        unique = {
            "only_over_dds": sorted(seen.difference(*(each[key] for each in simulated))),
            "only_in_process": sorted(what for what in missing if what.partition(":")[0] not in incomplete),
        }
        if any(unique.values()):
            found[key] = unique
    return found


def compare(drawn: Plan) -> tuple[dict[str, object], list[str]]:
    """Run a script in both; returns a row for JSON and the log lines of the run over DDS."""
    with tempfile.TemporaryDirectory() as folder:
        real = DdsRun(select_playable(drawn), Path(folder)).play()
    return compare_reports(drawn, real), real.log


def compare_reports(drawn: Plan, real: Report) -> dict[str, object]:
    """Compare a run over DDS with simulated runs of the same script; returns a row for JSON.

    A process takes seconds to start; a simulated one takes none. In lockstep a busy machine slows the arm. On one machine no message
    overtakes another, and on a quiet one none waits for the processor and a plan takes 0.2 s. If the outcomes differ, the simulation
    therefore repeats the script with the measured times on such a machine, up to three times: as it is, longer, and with each time shifted
    by up to 0.3 s.
    A node that a fault ends does not publish the counts of its last second. Refusals while the graph starts are counted in simulation only.
    """
    plan = select_playable(drawn)
    incomplete = {fault.target for fault in plan.faults if fault.kind in ("crash", "stop")}
    first, usual = play(plan), find_outcome(play(replace(plan, faults=())))["refusals"]
    rng, real_outcome, simulated = np.random.default_rng([plan.seed, 2]), find_outcome(real), [find_outcome(first)]
    pace = real.period / first.period if plan.mode == "lockstep" else 1.0
    quiet = replace(plan, slowest=plan.slowest * pace, reordered=0.0, delayed=0.0, planning=_PLANNING)
    for horizon, shift in ((plan.horizon, 0.0), (real.simulated + _LONGER, 0.0), (real.simulated + _LONGER, _SHIFT)):
        if not find_differences(real_outcome, simulated, incomplete, usual):
            break
        faults = [replace(f, at=max(0.0, f.at + (f.at > 0) * rng.uniform(-shift, shift))) for f in real.plan.faults]
        faults = tuple(sorted(faults, key=lambda fault: fault.at))
        simulated.append(find_outcome(play(replace(quiet, faults=faults, horizon=horizon))))
    return {
        "seed": plan.seed,
        "mode": plan.mode,
        "domain": plan.domain,
        "faults": [str(fault) for fault in plan.faults],
        "left_out": [fault.kind for fault in drawn.faults if fault not in plan.faults],
        "phases": real.phases,
        "refusals": {key: count for key, count in real.refusals.items() if count},
        "violations": real.violations,
        "pace": round(pace, 2),
        "differs_as_drawn": find_differences(real_outcome, simulated[:1], incomplete, usual),
        "differs": find_differences(real_outcome, simulated, incomplete, usual),
    }
