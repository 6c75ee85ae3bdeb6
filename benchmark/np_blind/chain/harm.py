"""Harm looked at again: of cases whose patch made the held-out motion worse, more recordings that nobody has heard.

Twenty windows know the share that a patch removes to a tenth. `--more` further recordings of a case, with other starts and other noise, ask whether the
motion is worse with what was named, and with the key's own effects. The last line printed is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from sim2real.effects import SCENE_RECORDS
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.task.contact_force.stage import Believed
from sim2real.task.object_motion.stage import errors, share
from sim2real.task.object_motion.windows import FAMILIES

from np_blind.chain.answering import NAME as ANSWER
from np_blind.chain.answering import publish, settle_all
from np_blind.chain.cases import Case, draw
from np_common.cli import Parser
from np_description.domains import BUMP

NAME = "harm.json"
NUMBERS = {"table_friction": "table", "object_mass": "mass", "gripper_friction": "finger"}
"""Of effects that the hand feels: the number that was measured."""


def patch_of(row: Mapping) -> Patch:
    """What an answer named of friction and mass, by what it measured of them."""
    believed, found = Believed.of(BUMP), []
    for effect, number in NUMBERS.items():
        if any(effect in ids for ids in row["named"]):
            relative = row["intervals"][number]["value"] / getattr(believed, number) - 1
            found.append(PatchEffect(effect, str(SCENE_RECORDS[effect].part), {"relative": relative}))
    return Patch(tuple(found))


def ask(case: Case, seed: int, answers: Path, more: int) -> dict:
    """px by which corners are seen off in each window of each recording: as believed, with what was named, with what is true."""
    from np_blind.chain.judged import FELT_FIRST, HELD_OUT, recorded

    patch = patch_of(json.loads((answers / f"case_{case.number:03d}" / ANSWER).read_text(encoding="utf-8")))
    tried = {"believed": Patch(), "patch": patch, "truth": case.patch}
    recordings = []
    for number in range(2, 2 + more):  # the first is the one of the set
        fresh = [recorded(case, seed + number * HELD_OUT, (FELT_FIRST, *FAMILIES))]
        recordings.append({name: errors(fresh, one).tolist() for name, one in tried.items()})
    given = {one.effect: dict(one.parameters) for one in patch.effects}
    return {"case": case.number, "kind": case.kind, "gap": case.gap, "patch": given, "recordings": recordings}


def told(row: Mapping) -> dict:
    """Of a case: windows, px of each, and shares of the error that are gone, with intervals over windows."""
    off = {
        n: np.concatenate([one[n] for one in row["recordings"]]).astype(float) for n in ("believed", "patch", "truth")
    }
    known = np.all([np.isfinite(values) for values in off.values()], axis=0)
    gone = {name: share(off["believed"][known], off[name][known]) for name in ("patch", "truth")}
    return {
        "windows": int(known.sum()),
        **{name: float(values[known].mean()) for name, values in off.items()},
        **{f"{name}_removes": [one.value, one.low, one.high] for name, one in gone.items()},
    }


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = Parser(
        prog="python -m np_blind.chain.harm", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, nargs="+", required=True, help="numbers")
    parser.add_argument("--of", type=int, default=72, help="how many the set has (default: %(default)s)")
    parser.add_argument("--seed", type=int, required=True, help="of the set")
    parser.add_argument("--answers", type=Path, required=True, help="folder of the set, with its answers")
    parser.add_argument("--more", type=int, default=4, help="recordings of each case (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder; what is there already is not done again")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    cases = [case for case in draw(options.of, options.seed) if case.number in options.cases]
    with ProcessPoolExecutor(options.jobs) as pool:
        asked = partial(ask, answers=options.answers, more=options.more)
        rows = settle_all(cases, options.seed, options.out, pool, asked, NAME)
    rows = [row if row.get("error") else row | {"told": told(row)} for row in rows]
    asked_for = " ".join(str(row["case"]) for row in rows)
    command = f"chain.harm --cases {asked_for} --of {options.of} --seed {options.seed} --answers FOLDER --out FOLDER"
    publish(options.out / NAME, command, options.seed, rows=rows)
    print(json.dumps({row["case"]: row.get("told", row.get("error")) for row in rows}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
