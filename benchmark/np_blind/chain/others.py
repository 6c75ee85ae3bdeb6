"""What others make of the chain's set: a baseline asked of its cases, judged as the doctor is by the motion that nobody heard.

A baseline hears the recording that the doctor hears. paper: the paper's identification of the arm; residual: a learned residual; cma: CMA-ES over
seven numbers at once. Answers lie in a folder a case, and a call asks what --out lacks; JOBS cases at a time, or those of a Dask cluster. Needs SAPIEN
(`make physx`). With --doctor, the folder of the set, its answers to the same cases stand beside them: the doctor's, and those of everything at
once. The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np

from np_blind.chain.answering import NAME as ANSWER
from np_blind.chain.answering import answered, publish, settle_all
from np_blind.chain.cases import Case, draw
from np_blind.chain.figures import HARM, rates, share_of_true
from np_blind.repository import relative
from np_common.cli import Parser
from np_common.parallel import HELP, SINGLE_THREAD, workers

METHODS = ("paper", "residual", "cma")
BESIDE = ("doctor", "at once")
NAME = "others.json"  # of the answers to a case, in its folder


@dataclass(frozen=True, eq=False)
class Told:
    """What a baseline makes of a recording. named: effects, None of one that names nothing ever; found: its numbers by name; off: px (n,) by which
    corners are seen off in the windows of other recordings of the same set-up, NaN where nothing is predicted (`motion.stage.errors`); more: what
    else is worth keeping."""

    named: list[str] | None
    found: Mapping[str, float]
    off: Callable[[Sequence], np.ndarray]
    more: Mapping[str, float] = field(default_factory=dict)


def ask(case: Case, seed: int, methods: Sequence[str], seconds: float) -> dict:
    """What baselines make of a case, and what is left of the held-out motion with each. seconds: that CMA-ES may take."""
    from sim2real.effects.patch import Patch
    from sim2real.task.object_motion.stage import errors
    from sim2real.task.object_motion.windows import FAMILIES

    from np_blind.chain.judged import FELT_FIRST, HELD_OUT, recorded

    begun = time.perf_counter()
    recording, fresh = recorded(case, seed), recorded(case, seed + HELD_OUT, (FELT_FIRST, *FAMILIES))
    made_s = time.perf_counter() - begun
    known = {name: errors([fresh], patch) for name, patch in (("believed", Patch()), ("truth", case.patch))}
    told = {}
    for method in methods:
        begun = time.perf_counter()
        try:
            told[method] = _asked(method, recording, case.number, seconds, fresh, known)
        except Exception:
            told[method] = {"error": relative(traceback.format_exc(limit=3))}
        told[method]["wall_s"] = time.perf_counter() - begun
    return {"case": case.number, "kind": case.kind, "gap": case.gap, "made_s": made_s, "methods": told}


def _asked(method: str, recording, number: int, seconds: float, fresh, known: Mapping[str, np.ndarray]) -> dict:
    search = import_module(f"np_blind.chain.baselines.{method}").ask
    told = search(recording, number, **({"seconds": seconds} if method == "cma" else {}))
    off = {**known, "after": told.off([fresh])}
    whole = np.all([np.isfinite(values) for values in off.values()], axis=0)
    motion = {"windows": int(whole.sum()), **{name: float(values[whole].mean()) for name, values in off.items()}}
    return {"named": told.named, "found": dict(told.found), **told.more, "motion": motion}


def beside(row: Mapping, answer: Mapping) -> dict:
    """A row with what the set's own answer to its case has: of the doctor, and of everything at once. Of a class the doctor is taken to name the
    true member, if it is one."""
    gap, motion = row["gap"], answer["motion"]
    told = (
        ([next((one for one in ids if one in gap), ids[0]) for ids in answer["named"]], "patch"),
        (answer["at_once"], "at_once"),
    )
    kept = {one: motion[one] for one in ("windows", "believed", "truth")}
    found = {name: {"named": named, "motion": {**kept, "after": motion[of]}} for name, (named, of) in zip(BESIDE, told)}
    return {**row, "methods": {**row["methods"], **found}}


def figures(rows: Sequence[Mapping], method: str) -> dict:
    """As of the doctor (`chain.figures`): right effects and nothing else, false alarms, harm, and the share of held-out motion removed."""
    asked = [
        {**row, **row.get("methods", {}).get(method, {})}
        for row in rows
        if row.get("error") or method in row.get("methods", {})
    ]
    ok = [row for row in asked if not row.get("error") and "motion" in row]
    names = [row for row in ok if row["named"] is not None]
    moved = [row["motion"] for row in ok if row["motion"]["windows"]]
    told = {
        "right effects, singles": [set(r["named"]) == set(r["gap"]) for r in names if r["kind"] == "single"],
        "right effects, pairs": [set(r["named"]) == set(r["gap"]) for r in names if r["kind"] == "pair"],
        "false alarm, clean": [bool(r["named"]) for r in names if r["kind"] == "clean"],
        "does harm to held-out motion": [1 - m["after"] / m["believed"] < HARM for m in moved],
        "errors": [bool(row.get("error")) for row in asked],
    }
    known = [r["motion"] for r in ok if r["kind"] in ("single", "pair") and r["motion"]["windows"]]
    share = share_of_true(known, "after")
    return rates(told) | ({"held-out motion: share of what the true effects remove": share} if share else {})


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = Parser(
        prog="python -m np_blind.chain.others",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS, help="baselines (all)")
    parser.add_argument("--cases", type=int, default=16, help="how many of the set (default: %(default)s)")
    parser.add_argument("--of", type=int, default=72, help="how many the set has (default: %(default)s)")
    parser.add_argument("--seed", type=int, required=True, help="of the set")
    parser.add_argument("--seconds", type=float, default=600.0, help="of CMA's search, a case (default: %(default)s)")
    parser.add_argument("--answered", action="store_true", help="score what is answered, and ask nothing")
    parser.add_argument("--doctor", type=Path, help="folder of the set with the doctor's answers, to stand beside")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--cluster", default="", help=HELP)
    parser.add_argument("--out", type=Path, required=True, help="folder; what is there already is not done again")
    options = parser.parse_args(arguments)
    cases = draw(options.of, options.seed)[: options.cases]
    options.out.mkdir(parents=True, exist_ok=True)
    if options.answered:
        rows = answered(cases, options.out, NAME)
    else:
        os.environ.update(SINGLE_THREAD)  # of the processes that are started: a case has a core
        asked = partial(ask, methods=tuple(options.methods), seconds=options.seconds)
        with workers(options.jobs, options.cluster) as pool:
            rows = settle_all(cases, options.seed, options.out, pool, asked, NAME)
    if options.doctor:
        own = {row["case"]: row for row in answered(cases, options.doctor, ANSWER) if not row.get("error")}
        rows = [beside(row, own[row["case"]]) if "methods" in row and row["case"] in own else row for row in rows]
    methods = [one for one in (*METHODS, *BESIDE) if any(one in row.get("methods", {}) for row in rows)]
    results, found = options.out / NAME, {method: figures(rows, method) for method in methods}
    command = f"chain.others --cases {options.of} --seed {options.seed} --out FOLDER"
    publish(results, command, options.seed, drawn=options.of, figures=found, rows=rows)
    print(json.dumps({"cases": len(rows), **found, "results": str(results)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
