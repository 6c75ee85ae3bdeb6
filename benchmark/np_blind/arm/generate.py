"""Making the bags of sealed cases.

    python -m np_blind.arm.generate --cases 24 --seed 0 --set development --out FOLDER

FOLDER gets bags/case_000, ... (rosbag2 folders with nothing in them that distinguishes one from another), key.json,
and key.sha256; of a set of changes references/case_000, ... too, the arms as they were.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from pathlib import Path

import numpy as np
from sim2real.excitation.suite import make_suite

from np_blind.arm import six_motion
from np_blind.arm.loop import Targets, make_targets, run_stable_arms
from np_blind.arm.sampling.cases import SETS, ArmCase, baseline_case, draw_cases, make_physics
from np_blind.arm.sampling.changes import SECOND_DAY
from np_blind.arm.sampling.key import make_key
from np_blind.sealed import digest
from np_common.cli import Parser, Progress
from np_common.parallel import HELP, workers

BATCH = 25  # arms moved at once, at most: 30 MB each
LATER = 86_400 * 1_000_000_000  # ns, from the first day to the second


def batches(cases: Sequence[ArmCase], jobs: int) -> list[list[ArmCase]]:
    """The cases, shared among so many processes."""
    size = min(BATCH, -(-len(cases) // jobs))
    return [list(cases[k : k + size]) for k in range(0, len(cases), size)]


def bag_path(out: Path, number: int) -> Path:
    """The bag of a case."""
    return out / "bags" / f"case_{number:03d}"


def reference_path(out: Path, number: int) -> Path:
    """The bag of a case of a set of changes as the arm was."""
    return out / "references" / f"case_{number:03d}"


def make_bags(cases: Sequence[ArmCase], only: Sequence[str], out: Path) -> dict[int, str]:
    """Move the arms of some cases through the suite and write their bags; of those of two days those of the first before.

    By the number of each case, what went wrong; "" where its bag is written. An arm that runs away has none,
    and leaves the others as they are.
    """
    targets = make_targets(make_suite(only))
    before = _record([baseline_case(case) for case in cases if case.day], targets, reference_path, out)
    lost = {number: error for number, error in before.items() if error}
    return lost | _record([case for case in cases if case.number not in lost], targets, bag_path, out)


def _record(cases: Sequence[ArmCase], targets: Targets, path: Callable[[Path, int], Path], out: Path) -> dict[int, str]:
    from np_blind.arm.bags import write_bag  # slow: no --help should wait for it

    if not cases:
        return {}
    if cases[0].has_six_hinges:
        seeds, paths = [case.noise for case in cases], [path(out, case.number) for case in cases]
        lost = six_motion.record(make_physics(list(cases))[0], seeds, paths)
        return {case.number: _said(lost[arm]) if arm in lost else "" for arm, case in enumerate(cases)}
    record, staying, lost = run_stable_arms(make_physics(list(cases))[0], targets, [case.noise for case in cases])
    for row, arm in enumerate(staying):
        case = cases[arm]
        begin = int(np.random.default_rng([*case.seed, 3]).integers(1, 1000)) * 1_000_000_000
        begin += LATER * (case.day == SECOND_DAY)
        information = {"origin": "np_diagnosis blind test", "case": case.number}
        write_bag(path(out, case.number), record, row, targets, begin, information)
    errors = {cases[arm].number: _said(time) for arm, time in lost.items()}
    errors |= {cases[arm].number: "" for arm in staying}
    return errors


def _said(time: float) -> str:
    return f"no recording: the arm ran away after {time:.3f} s"


def recording_path(path: Path) -> Path:
    """What the diagnosis is given of a recording's folder: the folder of a bag, else the file in it. Whether it `exists` shows
    whether it is complete."""
    own = path / six_motion.FILE
    return own if own.exists() else path if (path / "metadata.yaml").exists() else own


def add_options(parser: argparse.ArgumentParser, which: str) -> None:
    """The options that name a set of cases."""
    parser.add_argument("--cases", type=int, default=200, help="how many (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of everything random about them (default: %(default)s)")
    parser.add_argument("--set", choices=list(SETS), default=which, dest="which", help="default: %(default)s")
    parser.add_argument("--only", nargs="*", default=[], metavar="EXPERIMENT", help="part of the suite")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--cluster", default="", help=HELP)


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    parser = Parser(prog="python -m np_blind.arm.generate", description=__doc__.split("\n")[0])
    add_options(parser, "development")
    parser.add_argument("--out", type=Path, required=True, help="folder to make")
    options = parser.parse_args(arguments)
    if options.cases < 1 or options.jobs < 1:
        parser.error("--cases, --jobs: expected at least 1")
    try:
        key = make_key(options.cases, options.seed, options.which, options.only)
        options.out.mkdir(parents=True)
    except FileExistsError as error:
        print(f"generate: expected a new folder: {error}", file=sys.stderr)
        return 1
    except ValueError as error:
        print(f"generate: {error}", file=sys.stderr)
        return 1
    (options.out / "key.json").write_text(key)
    (options.out / "key.sha256").write_text(f"{digest(key)}  key.json\n")
    cases = draw_cases(options.cases, options.seed, options.which)
    bar, errors = Progress(len(cases), f"generate {options.which} {options.seed}"), {}
    with workers(options.jobs, options.cluster) as pool:
        pending = [pool.submit(make_bags, batch, options.only, options.out) for batch in batches(cases, options.jobs)]
        for future in as_completed(pending):
            errors |= future.result()
            bar.show(len(errors))
    lost = {number: error for number, error in sorted(errors.items()) if error}
    print(
        json.dumps(
            {
                "out": str(options.out),
                "cases": len(cases),
                "errors": lost,
                "set": options.which,
                "seed": options.seed,
                "key_sha256": digest(key),
            }
        )
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
