"""What others make of the chain's set: a baseline asked of its cases, judged as the doctor is by the motion that nobody heard.

A baseline (`METHODS`) hears the recording that the doctor hears. cma: CMA-ES over seven numbers at once (needs `pip install cma`, as paper does);
paper: the paper's identification of the arm; residual: a learned residual. Answers lie in a folder a case, and a call asks what --out lacks. Needs
SAPIEN (`make physx`). The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np

from np_blind.task_answering import answered, settle_all
from np_blind.task_cases import SET, Case, draw
from np_blind.task_figures import HARM, rates, share_of_true
from np_record.workers import HELP, SINGLE_THREAD, workers

METHODS = ("paper", "residual", "cma")


@dataclass(frozen=True, eq=False)
class Told:
    """What a baseline makes of a recording. named: effects, None of one that names nothing ever; found: its numbers by name; off: px (n,) by which
    corners are seen off in the windows of other recordings of the same set-up, NaN where nothing is predicted (`motion.stage.errors`); more: what
    else is worth keeping."""

    named: list[str] | None
    found: Mapping[str, float]
    off: Callable[[Sequence], np.ndarray]
    more: Mapping[str, float] = field(default_factory=dict)


def ask(case: Case, seed: int, method: str, seconds: float, recordings: Path | None) -> dict:
    """What a baseline makes of a case, and what is left of the held-out motion with it. seconds: that a search may take; recordings: folder in
    which what was recorded is kept for the next baseline, or None."""
    from np_diagnosis.chain.motion.stage import errors
    from np_effects.patch import Patch

    begun = time.perf_counter()
    recording, fresh = _recorded(case, seed, recordings)
    made = time.perf_counter()
    search = import_module(f"np_blind.task_{method}").ask
    told = search(recording, case.number, **({"seconds": seconds} if method == "cma" else {}))
    asked = time.perf_counter()
    off = {"believed": errors([fresh], Patch()), method: told.off([fresh]), "truth": errors([fresh], case.patch)}
    known = np.all([np.isfinite(values) for values in off.values()], axis=0)
    return {
        "case": case.number,
        "kind": case.kind,
        "gap": case.gap,
        "found": dict(told.found),
        "named": told.named,
        **told.more,
        "motion": {"windows": int(known.sum()), **{name: float(v[known].mean()) for name, v in off.items()}},
        "made_s": made - begun,
        "asked_s": asked - made,
        "wall_s": time.perf_counter() - begun,
    }


def _recorded(case: Case, seed: int, folder: Path | None):
    """The suite, and the recording that nobody hears."""
    from np_blind.task_judged import FELT_FIRST, HELD_OUT, recorded
    from np_diagnosis.chain.motion.windows import FAMILIES

    kept = folder / f"{SET}_{seed}_{case.number:03d}.pickle" if folder else None
    if kept and kept.exists():
        return pickle.loads(kept.read_bytes())
    made = recorded(case, seed), recorded(case, seed + HELD_OUT, (FELT_FIRST, *FAMILIES))
    if kept:
        partial_ = kept.with_suffix(f".{os.getpid()}")
        partial_.write_bytes(pickle.dumps(made))
        os.replace(partial_, kept)
    return made


def figures(rows: Sequence[Mapping], method: str) -> dict:
    """As of the doctor (`task_figures`): right effects and nothing else, false alarms, harm, and the share of held-out motion removed."""
    ok = [row for row in rows if not row.get("error")]
    names = [row for row in ok if row["named"] is not None]
    moved = [row["motion"] for row in ok if row["motion"]["windows"]]
    told = {
        "right effects, singles": [set(r["named"]) == set(r["gap"]) for r in names if r["kind"] == "single"],
        "right effects, pairs": [set(r["named"]) == set(r["gap"]) for r in names if r["kind"] == "pair"],
        "false alarm, clean": [bool(r["named"]) for r in names if r["kind"] == "clean"],
        "does harm to held-out motion": [1 - m[method] / m["believed"] < HARM for m in moved],
        "errors": [bool(row.get("error")) for row in rows],
    }
    known = [r["motion"] for r in ok if r["kind"] in ("single", "pair") and r["motion"]["windows"]]
    share = share_of_true(known, method)
    return rates(told) | ({"held-out motion: share of what the true effects remove": share} if share else {})


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="python -m np_blind.task_others", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--method", choices=METHODS, required=True, help="baseline")
    parser.add_argument("--cases", type=int, default=16, help="how many of the set (default: %(default)s)")
    parser.add_argument("--of", type=int, default=72, help="how many the set has (default: %(default)s)")
    parser.add_argument("--seed", type=int, required=True, help="of the set")
    parser.add_argument(
        "--seconds", type=float, default=600.0, help="of CMA's search, each case (default: %(default)s)"
    )
    parser.add_argument("--answered", action="store_true", help="score what is answered, and ask nothing")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--cluster", default="", help=HELP)
    parser.add_argument(
        "--recordings", type=Path, help="folder that keeps what is recorded for the next baseline (4 MB a case)"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder; what is there already is not done again")
    options = parser.parse_args(arguments)
    cases, name = draw(options.of, options.seed)[: options.cases], f"{options.method}.json"
    for folder in filter(None, (options.out, options.recordings)):
        folder.mkdir(parents=True, exist_ok=True)
    if options.answered:
        rows = answered(cases, options.out, name)
    else:
        os.environ.update(SINGLE_THREAD)  # of the processes that are started: a case has a core
        asked = partial(ask, method=options.method, seconds=options.seconds, recordings=options.recordings)
        with workers(options.jobs, options.cluster) as pool:
            rows = settle_all(cases, options.seed, options.out, pool, asked, name)
    found = {"set": SET, "seed": options.seed, "drawn": options.of, "method": options.method}
    found |= {"figures": figures(rows, options.method), "rows": rows}
    results = options.out / name
    results.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps({"cases": len(rows), **found["figures"], "results": str(results)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
