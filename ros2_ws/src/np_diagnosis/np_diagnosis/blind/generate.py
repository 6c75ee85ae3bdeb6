"""Making sealed cases: a bag for each arm, and a key whose SHA-256 is known before anyone is asked.

    python -m np_diagnosis.blind.generate --cases 24 --seed 0 --set development --out FOLDER

FOLDER gets case_000, case_001, ... (rosbag2 folders with nothing in them that tells one from another),
key.json, and key.sha256. The key says of each case its kind, faults, parameters and sizes, and the gap of
held-out motions without noise: `gap_nominal` of the nominal arm, `gap_oracle` of the nominal arm with the
true faults, both in rad, RMS over time and joints.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from np_diagnosis.blind.bags import write_bag
from np_diagnosis.blind.cases import SETS, Case, draw_cases, magnitude, make_physics
from np_diagnosis.blind.heldout import gaps, heldout_targets, motions
from np_diagnosis.blind.loop import make_targets, run
from np_diagnosis.blind.plant import stack
from np_diagnosis.blind.progress import Bar
from np_diagnosis.excitation import suite

BATCH = 25  # arms moved at once, at most
SCHEMA = 1


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = argparse.ArgumentParser(prog="generate", description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--set", choices=list(SETS), default="development", dest="which")
    parser.add_argument("--only", nargs="*", default=[], metavar="EXPERIMENT", help="part of the suite")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder to make")
    options = parser.parse_args(arguments)
    if options.cases < 1 or options.jobs < 1:
        parser.error("--cases, --jobs: expected at least 1")
    return options


def generate(count: int, seed: int, which: str, out: Path, jobs: int = 1, only: list[str] = ()) -> str:
    """Write bags and key; the key's SHA-256. Raises FileExistsError for a folder that is there."""
    out.mkdir(parents=True)
    cases = draw_cases(count, seed, which)
    size = min(BATCH, -(-count // jobs))
    batches = [cases[k:k + size] for k in range(0, count, size)]
    bar, entries = Bar(count, f"generate {which} {seed}"), []
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        pending = [pool.submit(_make_batch, batch, seed, list(only), str(out)) for batch in batches]
        for future in pending:
            entries += future.result()
            bar.show(len(entries))
    key = {"schema": SCHEMA, "set": which, "seed": seed, "experiments": list(only), "cases": entries}
    text = json.dumps(key, indent=1, sort_keys=True) + "\n"
    digest = hashlib.sha256(text.encode()).hexdigest()
    (out / "key.json").write_text(text)
    (out / "key.sha256").write_text(f"{digest}  key.json\n")
    return digest


def _make_batch(cases: list[Case], seed: int, only: list[str], out: str) -> list[dict]:
    """Bags of some cases, and their entries of the key."""
    targets = make_targets(suite(only))
    physics, truths = make_physics(cases)
    record = run(physics, targets, [case.seed for case in cases])
    for i, case in enumerate(cases):
        rng = np.random.default_rng([*case.seed, 3])
        begin = int(rng.integers(1, 1000)) * 1_000_000_000
        information = {"origin": "np_diagnosis blind test", "case": case.number}
        write_bag(Path(out) / f"case_{case.number:03d}", record, i, targets, begin, information)
    clean = [Case(case.number, "null", (), case.seed) for case in cases]
    arms = [physics, make_physics(clean, background=False)[0], make_physics(cases, background=False)[0]]
    truth, nominal, oracle = np.split(motions(stack(arms), heldout_targets()), 3, axis=1)
    return [{"case": case.number, "kind": case.kind,
             "faults": [{**asdict(fault), "component": fault.component, "magnitude": magnitude(fault),
                         "parameters": {name: {"value": float(value), "unit": unit}
                                        for name, (value, unit) in parameters.items()}}
                        for fault, parameters in zip(case.faults, truths[i])],
             "gap_nominal": float(gaps(nominal, truth)[i]), "gap_oracle": float(gaps(oracle, truth)[i])}
            for i, case in enumerate(cases)]


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    options = parse(arguments)
    try:
        digest = generate(options.cases, options.seed, options.which, options.out, options.jobs, options.only)
    except (FileExistsError, ValueError) as error:
        print(f"generate: {error}", file=sys.stderr)
        return 1
    print(json.dumps({"out": str(options.out), "cases": options.cases, "set": options.which,
                      "seed": options.seed, "key_sha256": digest}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
