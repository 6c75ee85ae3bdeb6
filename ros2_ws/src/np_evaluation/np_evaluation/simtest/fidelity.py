"""One script in the simulation and over DDS: what came of it in both, and what in one alone."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from np_description.phases import FAULT
from np_evaluation.simtest.over_dds import DdsRun, playable
from np_evaluation.simtest.plan import Plan, Report
from np_evaluation.simtest.shrink import play

_LONGER = 5.0  # s that simulated runs go on for, which a call to a node that starts may have held up
_SHIFT = 0.3  # s by which each time may be other in the last simulated run
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")


def outcome(report: Report) -> dict[str, set[str]]:
    """What a run came to: promises broken, phases reached, faults raised, reasons of refusals by node. Without numbers."""
    return {
        "broken": set(report.violations),
        "phases": {phase.partition(":")[0] for phase in report.phases},
        "faults": {_NUMBER.sub("#", phase) for phase in report.phases if phase.startswith(FAULT)},
        "refusals": {key for key, count in report.refusals.items() if ": refused_" in key and count},
    }


def difference(
    real: Mapping[str, set[str]], simulated: Sequence[Mapping[str, set[str]]], unheard: Collection[str] = ()
) -> dict[str, dict[str, list[str]]]:
    """What a run over DDS had and none of the simulated ones, and what all of those had and it had not, where there is any.

    unheard: nodes of which not all counts are known over DDS.
    """
    found = {}
    for key, seen in real.items():
        missing = set.intersection(*(each[key] for each in simulated)) - seen
        alone = {
            "only_over_dds": sorted(seen.difference(*(each[key] for each in simulated))),
            "only_in_process": sorted(what for what in missing if what.partition(":")[0] not in unheard),
        }
        if any(alone.values()):
            found[key] = alone
    return found


def compare(drawn: Plan) -> tuple[dict[str, object], list[str]]:
    """A script in both: a row of JSON, and what happened over DDS, a line each."""
    with tempfile.TemporaryDirectory() as folder:
        real = DdsRun(playable(drawn), Path(folder)).play()
    return judge(drawn, real), real.log


def judge(drawn: Plan, real: Report) -> dict[str, object]:
    """What came otherwise over DDS: a row of JSON.

    A process takes seconds to start where a simulated one takes none, in lockstep a busy machine has a slower arm, and on one machine no
    message overtakes another. So where the two differ the simulation plays the script again with those times on such a network, as they
    were and with each shifted by up to 0.3 s, for as long as it took. A node that a fault ends has not said what it counted in its last
    second.
    """
    plan = playable(drawn)
    unheard = {fault.target for fault in plan.faults if fault.kind in ("crash", "stop")}
    first = play(plan)
    rng, came_of, simulated = np.random.default_rng([plan.seed, 2]), outcome(real), [outcome(first)]
    pace = real.period / first.period if plan.mode == "lockstep" else 1.0
    for shift in (0.0, _SHIFT):
        if not difference(came_of, simulated, unheard):
            break
        faults = [replace(f, at=max(0.0, f.at + (f.at > 0) * rng.uniform(-shift, shift))) for f in real.plan.faults]
        faults = tuple(sorted(faults, key=lambda fault: fault.at))
        again = replace(plan, faults=faults, horizon=real.simulated + _LONGER, slowest=plan.slowest * pace)
        simulated.append(outcome(play(replace(again, reordered=0.0))))
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
        "differs_as_drawn": difference(came_of, simulated[:1], unheard),
        "differs": difference(came_of, simulated, unheard),
    }
