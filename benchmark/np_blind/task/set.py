"""The task set: `diagnose_task` on recordings of the task suite in PhysX, whose gap only the key holds.

`--seal` writes the hash of the key, to be committed. A case is a folder, and a call evaluates the cases that --out lacks:
JOBS cases at a time, or those of a Dask cluster. A seed below 900 is a development set and needs no seal. Needs SAPIEN (`make physx`). The
last line printed is one JSON object; task.json lies in the folder.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

from np_blind.sealed import SealError, check_diagnosis_code, check_hash, commit_hash, digest
from np_blind.task.cases import SET, draw, make_key
from np_blind.task.figures import figures
from np_blind.task.jobs import evaluate_cases, publish
from np_common.cli import INTERRUPTED, Parser, interrupt_on_sigterm
from np_common.parallel import HELP, SINGLE_THREAD, workers
from np_common.parallel import missing as missing_cluster
from np_physx_bridge.library import missing

LOCKED_FROM = 900  # seed from which on a set is sealed


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(
        prog="python -m np_blind.task.set",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cases", type=int, default=16, help="how many (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of everything random about them (default: %(default)s)")
    parser.add_argument("--seal", action="store_true", help="put down the key's hash, and do no more")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--cluster", default="", help=HELP)
    parser.add_argument(
        "--out", type=Path, help="folder; what is there already is not done again (default: runs/blind/task_CASES_SEED)"
    )
    options = parser.parse_args(arguments)
    if options.cases < 1 or options.jobs < 1:
        parser.error("--cases, --jobs: expected at least 1")
    if problem := missing_cluster(options.cluster):
        parser.error(f"--cluster {problem}")
    options.out = (options.out or Path("runs/blind") / f"{SET}_{options.cases}_{options.seed}").resolve()
    return options


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    options = parse(arguments)
    interrupt_on_sigterm()
    try:
        key = make_key(options.cases, options.seed)
        if options.seal:
            print(json.dumps({"sha256": commit_hash(key)}))
            return 0
        if problem := missing():  # before a sealed set is spent on errors
            raise OSError(problem)
        is_locked = options.seed >= LOCKED_FROM
        sealed = check_hash(key) if is_locked else digest(key)
        options.out.mkdir(parents=True, exist_ok=True)
        code = check_diagnosis_code(options.out, is_locked)
        os.environ.update(SINGLE_THREAD)  # of the processes that are started: a case has a core
        cases = draw(options.cases, options.seed)
        with workers(options.jobs, options.cluster) as pool:
            rows = evaluate_cases(cases, options.seed, options.out, pool)
    except KeyboardInterrupt:
        print("interrupted; results are kept, the same command goes on with the next", file=sys.stderr)
        return INTERRUPTED
    except (SealError, OSError) as error:
        print(f"task.set: {error}", file=sys.stderr)
        return 2 if isinstance(error, SealError) else 1
    results, found = options.out / "task.json", figures(rows)
    publish(
        results,
        f"task.set --cases {options.cases} --seed {options.seed} --out FOLDER",
        options.seed,
        drawn=options.cases,
        key_sha256=sealed,
        diagnosis_sha256=code,
        figures=found,
        rows=rows,
    )
    print(json.dumps({"cases": len(rows), **found, "results": str(results)}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
