"""The chain's blind set: `chain` asked of the task suite in PhysX, whose gap is known to the key alone.

`python -m np_blind.task_set --cases 16 --seed 900 --seal` puts down the hash of the key, to be committed;
`python -m np_blind.task_set --cases 16 --seed 900 --out FOLDER` makes and answers the cases that FOLDER lacks (a directory each, done once
its answer lies there) and writes FOLDER/task.json. A seed below 900 is a development set and needs no seal. Needs SAPIEN (`make physx`).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from np_blind.sealed import SealError, check, check_doctor, digest, put_down
from np_blind.task_cases import OUT_OF_CATALOGUE, SET, Case, Detector, draw, make_key
from np_blind.task_reality import Reality
from np_description.camera import CAMERA
from np_description.domains import BUMP
from np_diagnosis.chain.force.stage import Believed
from np_diagnosis.chain.together.claims import module_of
from np_diagnosis.chain.together.whole import Seen, Whole, diagnose
from np_diagnosis.chain.view_stage.places import places
from np_record.command import Progress
from np_record.intervals import wilson_interval

LOCKED_FROM = 900  # seed from which on a set is sealed
NOISE, GROSS = 0.15, 0.01  # px and share, of the detector
MODULES = {"cable": "contact", "knocked": "camera"}


def answer(case: Case, seed: int) -> dict:
    """A case made, asked and judged."""
    from np_physx_bridge.engine import PhysxEngine  # where SAPIEN is

    class Pulled(PhysxEngine):
        """PhysX with a cable on the object."""

        def step(self, torque, extra, opening) -> None:
            """As in Engine."""
            if pull := case.gap.get("pull"):
                way = case.gap["way"]
                force = pull * np.array([np.cos(way), np.sin(way), 0.0])
                self.object.add_force_at_point(force, self.object.entity.pose.p)
            super().step(torque, extra, opening)

    begun = time.perf_counter()
    finding = Detector(seed * 1000 + case.number, NOISE, GROSS, case.gap.get("turn", 0.0), CAMERA.fx)
    recording = Reality(BUMP, case.patch, seed * 1000 + case.number, Pulled, finding).run()
    made = time.perf_counter()
    rests = tuple(place for place, _ in places(recording.track, recording.domain))
    found = diagnose(Seen((recording,), (recording.track,), rests))
    done = time.perf_counter()
    return {**judged(case, found), "made_s": made - begun, "asked_s": done - made}


def judged(case: Case, found: Whole) -> dict:
    """What is right about an answer."""
    claims = [claim for row in found.rows for claim in row.claims]
    named = [sorted({one for way in claim.ways for one in way.ids}) for claim in claims]
    modules = sorted({row.module for row in found.rows if row.claims or row.verdict == "unexplained"})
    true = MODULES.get(case.kind) or (module_of(case.kind) if case.is_known else None)
    return {
        "case": case.number,
        "kind": case.kind,
        "gap": case.gap,
        "verdict": found.verdict,
        "rows": {row.module: row.verdict for row in found.rows},
        "named": named,
        "said": [" or ".join(way.said for way in claim.ways) for claim in claims],
        "doubts": found.doubts,
        "module": modules == [true] if case.is_known else None,
        "effect": sum(case.kind in ids for ids in named) == 1 if case.is_known else None,
        "wrong": sum(case.kind not in ids for ids in named),
        "unexplained": found.verdict == "unexplained",
        "intervals": _intervals(case, found),
    }


def _intervals(case: Case, found: Whole) -> dict[str, dict]:
    """Every number that was measured beside the truth, its background included."""
    patch, believed = case.patch, Believed.of(BUMP)
    change = patch.scene_change()
    truths = {
        "table": believed.table * change.table,
        "finger": believed.finger * change.finger,
        "mass": believed.mass * change.mass,
    }
    told = {}
    if found.force and found.force.measured:
        told |= {name: (truths[name], *values) for name, values in found.force.measured.items()}
    if found.touch and found.touch.explained and "height" in found.touch.explained.bounds:
        value = found.touch.explained.bounds["height"]
        told["height"] = (change.lift, value.value, value.low, value.high)
    if found.lag and found.lag.late:
        late = sum(e.get("delay") for e in patch.of("camera_latency"))
        told["late"] = (late, found.lag.late.value, found.lag.late.low, found.lag.late.high)
    if found.force and found.force.least_finger is not None:
        told["least_finger"] = (truths["finger"], found.force.least_finger, found.force.least_finger, np.inf)
    return {
        name: {
            "true": true,
            "value": value,
            "low": low,
            "high": high if np.isfinite(high) else None,
            "holds": bool(low <= true <= high),
        }
        for name, (true, value, low, high) in told.items()
    }


def figures(rows: list[Mapping]) -> dict:
    """Shares of what is right, each with its Wilson interval and its number of cases."""
    ok = [row for row in rows if not row.get("error")]
    known, clean = [r for r in ok if r["module"] is not None], [r for r in ok if r["kind"] == "clean"]
    out = [r for r in ok if r["kind"] in OUT_OF_CATALOGUE]
    intervals = [
        one for r in ok if r["kind"] not in OUT_OF_CATALOGUE for n, one in r["intervals"].items() if n != "least_finger"
    ]
    asked = {
        "right module": [r["module"] for r in known],
        "right effect or class": [bool(r["effect"]) and not r["wrong"] for r in known],
        "false alarm, clean": [bool(r["named"]) or r["unexplained"] for r in clean],
        "out of catalogue: unexplained": [r["unexplained"] for r in out],
        "out of catalogue: named something": [bool(r["named"]) and not r["unexplained"] for r in out],
        "95 % intervals that hold": [one["holds"] for one in intervals],
        "errors": [bool(row.get("error")) for row in rows],
    }
    return {
        name: {"value": sum(of) / len(of), "ci95": list(wilson_interval(sum(of), len(of))), "of": len(of)}
        for name, of in asked.items()
        if of
    }


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="np_blind.task_set", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=16)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seal", action="store_true", help="put down the key's hash, and do no more")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    try:
        if options.seal:
            print(json.dumps({"sha256": put_down(make_key(options.cases, options.seed))}))
            return 0
        if options.out is None:
            parser.error("--out: expected a folder")
        options.out.mkdir(parents=True, exist_ok=True)
        is_locked = options.seed >= LOCKED_FROM
        key = make_key(options.cases, options.seed)
        sealed = check(key) if is_locked else digest(key)
        doctor = check_doctor(options.out, is_locked)
    except SealError as error:
        print(f"seal: {error}", file=sys.stderr)
        return 2
    rows = _rows(draw(options.cases, options.seed), options.seed, options.out)
    found = {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "command": f"python -m np_blind.task_set --cases {options.cases} --seed {options.seed} --out FOLDER",
        "set": SET,
        "seed": options.seed,
        "drawn": options.cases,
        "key_sha256": sealed,
        "doctor_sha256": doctor,
        "figures": figures(rows),
        "rows": rows,
    }
    (options.out / "task.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps({"cases": len(rows), **found["figures"]}))
    return 0


def _rows(cases: list[Case], seed: int, out: Path) -> list[dict]:
    progress, rows = Progress(len(cases), "task"), []
    for done, case in enumerate(cases):
        progress.show(done, f"case {case.number}")
        place = out / f"case_{case.number:03d}"
        kept = place / "answer.json"
        if not kept.exists():
            place.mkdir(exist_ok=True)
            try:
                row = answer(case, seed)
            except Exception:  # whatever goes wrong is an answer, and published
                row = {"case": case.number, "kind": case.kind, "gap": case.gap, "error": traceback.format_exc(limit=3)}
            new = kept.with_suffix(".new")
            new.write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
            new.replace(kept)
        rows.append(json.loads(kept.read_text(encoding="utf-8")))
    progress.show(len(cases), "done")
    return rows


if __name__ == "__main__":
    sys.exit(main())
