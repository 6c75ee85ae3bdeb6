"""A baseline of the chain's set: CMA-ES over all parameters at once, by how the object moves.

What is minimised is the error of the motion in the recording that the doctor hears (`chain.motion`), of which seven numbers decide. Nothing
competes and nothing is a class: what comes out beyond the limit of its effect is named. It is asked of cases that were answered, and its
answers lie beside theirs. Needs `cma` (`pip install cma`) and SAPIEN. The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from np_blind.task_answering import answered, settle_all
from np_blind.task_cases import RECORDS, SET, Case, draw
from np_blind.task_figures import HARM, MATTERS, rates


@dataclass(frozen=True)
class Number:
    """One parameter. effect, quantity: as a patch has it; spread: what a step of one is, about what a gap is; low, high: bounds."""

    effect: str
    quantity: str
    spread: float
    low: float
    high: float


NUMBERS = (
    Number("table_friction", "relative", 0.2, -0.7, 1.0),
    Number("object_mass", "relative", 0.2, -0.7, 1.0),
    Number("gripper_friction", "relative", 0.2, -0.7, 0.5),
    Number("table_height", "height", 0.004, -0.015, 0.015),
    Number("camera_extrinsics", "x", 0.005, -0.03, 0.03),
    Number("camera_extrinsics", "y", 0.005, -0.03, 0.03),
    Number("camera_latency", "delay", 0.02, 0.0, 0.12),
)
NAME = "cma.json"  # of an answer, beside the doctor's
WORST = 20.0  # px, of a window that cannot be predicted


def search(recording, seconds: float, seed: int) -> tuple[np.ndarray, float, int]:
    """Numbers (7,), px of the error of the motion that they leave, and how often it was asked. Ends after so many seconds at the latest."""
    import cma

    from np_diagnosis.chain.motion.stage import errors

    def off(x: np.ndarray) -> float:
        found = errors([recording], patch_of(x), rougher=(0.0,))
        return float(np.where(np.isfinite(found), found, WORST).mean())

    low, high = ([getattr(n, side) / n.spread for n in NUMBERS] for side in ("low", "high"))
    asked = cma.CMAEvolutionStrategy(
        np.zeros(len(NUMBERS)),
        0.5,
        {"bounds": [low, high], "seed": seed + 1, "timeout": seconds, "verbose": -9, "maxiter": 200},
    )
    asked.optimize(off)
    best = asked.result
    return np.asarray(best.xbest), float(best.fbest), int(best.evaluations)


def patch_of(x: Sequence[float]):
    """The patch of numbers (7,) in steps of their spreads."""
    from np_effects.patch import Patch, PatchEffect

    values: dict[str, dict[str, float]] = {}
    for number, step in zip(NUMBERS, x):
        value = min(max(float(step) * number.spread, number.low), number.high)
        values.setdefault(number.effect, {})[number.quantity] = value
    return Patch(tuple(PatchEffect(effect, str(RECORDS[effect].part), given) for effect, given in values.items()))


def named(x: Sequence[float]) -> list[str]:
    """Effects of which a number is beyond the limit that the effect declares."""
    beyond = (n.effect for n, step in zip(NUMBERS, x) if abs(step * n.spread) > RECORDS[n.effect].seen.limit)
    return sorted(set(beyond))


def ask(case: Case, seed: int, seconds: float) -> dict:
    """What CMA-ES makes of a case, and what is left of the held-out motion with it."""
    from np_blind.task_judged import FELT_FIRST, HELD_OUT, recorded
    from np_diagnosis.chain.motion.stage import errors
    from np_diagnosis.chain.motion.windows import FAMILIES
    from np_effects.patch import Patch

    begun = time.perf_counter()
    recording, fresh = recorded(case, seed), recorded(case, seed + HELD_OUT, (FELT_FIRST, *FAMILIES))
    x, left, evaluations = search(recording, seconds, case.number)
    off = {
        name: errors([fresh], one) for name, one in (("believed", Patch()), ("cma", patch_of(x)), ("truth", case.patch))
    }
    known = np.all([np.isfinite(values) for values in off.values()], axis=0)
    return {
        "case": case.number,
        "kind": case.kind,
        "gap": case.gap,
        "found": {f"{n.effect} {n.quantity}": float(step * n.spread) for n, step in zip(NUMBERS, x)},
        "named": named(x),
        "left": left,
        "evaluations": evaluations,
        "motion": {"windows": int(known.sum()), **{name: float(v[known].mean()) for name, v in off.items()}},
        "wall_s": time.perf_counter() - begun,
    }


def figures(rows: Sequence[Mapping]) -> dict:
    """As of the doctor (`task_figures`): right effects and nothing else, false alarms, harm, and the share of held-out motion removed."""
    ok = [row for row in rows if not row.get("error")]
    moved = [row["motion"] for row in ok if row["motion"]["windows"]]
    told = {
        "right effects, singles": [set(r["named"]) == set(r["gap"]) for r in ok if r["kind"] == "single"],
        "right effects, pairs": [set(r["named"]) == set(r["gap"]) for r in ok if r["kind"] == "pair"],
        "false alarm, clean": [bool(r["named"]) for r in ok if r["kind"] == "clean"],
        "does harm to held-out motion": [1 - m["cma"] / m["believed"] < HARM for m in moved],
        "errors": [bool(row.get("error")) for row in rows],
    }
    found = rates(told)
    known = [r["motion"] for r in ok if r["kind"] in ("single", "pair") and r["motion"]["windows"]]
    worth = [m for m in known if m["believed"] - m["truth"] > MATTERS * m["believed"]]
    if worth:
        gone = sum(m["believed"] - m["cma"] for m in worth) / sum(m["believed"] - m["truth"] for m in worth)
        found["held-out motion: share of what the true effects remove"] = {"value": gone, "of": len(worth)}
    return found


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m np_blind.task_cma", description=__doc__)
    parser.add_argument("--cases", type=int, default=16, help="how many of the set (default: %(default)s)")
    parser.add_argument("--of", type=int, default=72, help="how many the set has (default: %(default)s)")
    parser.add_argument("--seed", type=int, required=True, help="of the set")
    parser.add_argument("--seconds", type=float, default=600.0, help="of search, each case (default: %(default)s)")
    parser.add_argument("--answered", action="store_true", help="score what is answered, and ask nothing")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder; what is there already is not done again")
    options = parser.parse_args(arguments)
    cases = draw(options.of, options.seed)[: options.cases]
    options.out.mkdir(parents=True, exist_ok=True)
    if options.answered:
        rows = answered(cases, options.out, NAME)
    else:
        with ProcessPoolExecutor(options.jobs) as pool:
            rows = settle_all(cases, options.seed, options.out, pool, partial(ask, seconds=options.seconds), NAME)
    told = {"set": SET, "seed": options.seed, "drawn": options.of, "figures": figures(rows), "rows": rows}
    results = options.out / "cma.json"
    results.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    print(json.dumps({"cases": len(rows), **told["figures"], "results": str(results)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
