"""`blind`: the diagnosis on arms whose cause is sealed (benchmark/README.md).

Makes the bags, runs `diagnose` on each in a process of its own, then opens the key, checks its hash, and
scores. The last line printed is one JSON object. It needs no ROS.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict
from functools import partial
from pathlib import Path

from np_blind.arm.evaluation import baselines as others
from np_blind.arm.evaluation.dry_run import check_diagnosis_runs
from np_blind.arm.evaluation.follow_up import could_settle, is_answered
from np_blind.arm.evaluation.held_out_motion import heldout_gaps
from np_blind.arm.evaluation.jobs import DiagnosisJob, diagnose_cases, is_diagnosed, report_path
from np_blind.arm.evaluation.patched_arm import PatchError, patched_physics, read_patch
from np_blind.arm.evaluation.scoring import Score, score_case, score_gap, summary
from np_blind.arm.evaluation.tables import failures_table, figures_table, plot
from np_blind.arm.generate import add_options, batches
from np_blind.arm.sampling.cases import CHANGES, ArmCase, draw_cases
from np_blind.arm.sampling.key import make_key, seal
from np_blind.sealed import SealError, check_diagnosis_code, check_hash, digest
from np_common.cli import Parser
from np_common.parallel import workers

DIAGNOSIS = f"{shlex.quote(sys.executable)} -m sim2real.cli.diagnose"


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = Parser(prog="python -m np_blind.arm.set", description=__doc__.split("\n")[0])
    add_options(parser, "locked")
    parser.add_argument(
        "--out", type=Path, help="folder; what is there already is not done again (default: runs/blind/SET_CASES_SEED)"
    )
    parser.add_argument("--seal", action="store_true", help="only put down the key's hash, to be committed")
    parser.add_argument("--keep", action="store_true", help="keep the bags")
    parser.add_argument(
        "--diagnosis", default=DIAGNOSIS, help="command that is given BAG [--reference BAG] --out FOLDER"
    )
    parser.add_argument(
        "--baselines",
        action="store_true",
        help="beside the diagnosis: the paper's identification, "
        "mujoco.sysid and no fix (ten minutes and more of CPU a case)",
    )
    parser.add_argument("--identify", default=others.COMMAND, help="command of the baselines")
    parser.add_argument("--timeout", type=float, default=900.0, help="s of wall time for one case")
    options = parser.parse_args(arguments)
    if options.cases < 1 or options.jobs < 1:
        parser.error("--cases, --jobs: expected at least 1")
    if options.baselines and options.which in CHANGES:
        parser.error("--baselines: expected a set of single recordings, not of changes")
    options.out = options.out or Path("runs/blind") / f"{options.which}_{options.cases}_{options.seed}"
    return options


def score(
    cases: Sequence[ArmCase], entries: Sequence[dict], options: argparse.Namespace, pool: Executor
) -> list[Score]:
    """Score the diagnosed cases against their entries of the key."""
    scores, patches = [], []
    for case, entry in zip(cases, entries, strict=True):
        folder, report, patch = report_path(options.out, entry["case"]), None, []
        error = (folder / "error.txt").read_text()
        try:
            if not error:
                report = json.loads((folder / "report.json").read_text())
                if options.which not in CHANGES:  # no motion separates a patch from a change between two days
                    patch = read_patch(folder / "patch.yaml")
                    patched_physics([patch])
            scores.append(score_case(entry, report, error, case.has_measured_friction))
        except (OSError, PatchError, ArithmeticError, LookupError, TypeError, ValueError) as problem:
            patch = []
            scores.append(score_case(entry, None, repr(problem)))
        scores[-1].settled = is_answered(entry, folder)
        scores[-1].settled_known = scores[-1].settled if could_settle(entry, folder) else None
        patches.append(patch)
    if options.which in CHANGES:
        return scores
    first, followed = 0, []
    for part in batches(cases, options.jobs):
        followed.append(pool.submit(heldout_gaps, part, patches[first : first + len(part)]))
        first += len(part)
    gaps = [gap for future in followed for gap in future.result()]
    for case_score, gap in zip(scores, gaps):
        score_gap(case_score, *gap)
    return scores


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    options = parse(arguments)
    crew = partial(workers, cluster=options.cluster) if options.cluster else workers
    began = time.monotonic()
    try:
        if options.seal:
            print(json.dumps({"key_sha256": seal(options.cases, options.seed, options.which, options.only)}))
            return 0
        key = make_key(options.cases, options.seed, options.which, options.only)
        is_locked = options.which.startswith("locked")
        sealed = check_hash(key) if is_locked else digest(key)
        options.out.mkdir(parents=True, exist_ok=True)
        code = check_diagnosis_code(options.out, is_locked)
        cases = draw_cases(options.cases, options.seed, options.which)
        asking = DiagnosisJob(
            options.out.resolve(),
            options.diagnosis,
            options.timeout,
            options.keep,
            options.identify if options.baselines else "",
        )
        if is_locked and not all(is_diagnosed(options.out, case.number) for case in cases):
            check_diagnosis_runs(options.which, options.seed, asking, crew)
        diagnose_cases(cases, options.only, asking, options.jobs, crew)
        (options.out / "key.json").write_text(key)
        entries = json.loads(key)["cases"]
        with crew(options.jobs) as pool:
            scores = score(cases, entries, options, pool)
            folders = [report_path(options.out, case.number) for case in cases]
            beside = (
                others.score_baselines(entries, cases, folders, batches(cases, options.jobs), pool)
                if options.baselines
                else {}
            )
    except (SealError, ValueError, OSError) as error:
        print(f"blind: {error}", file=sys.stderr)
        return 1
    figures = {
        **summary(scores),
        "drawn": options.cases,
        "set": options.which,
        "seed": options.seed,
        "key_sha256": sealed,
        "diagnosis_sha256": code,
        **({"baselines": beside} if beside else {}),
        "wall_s": round(time.monotonic() - began, 1),
    }
    results = {
        "figures": figures,
        "cases": [asdict(s) for s in scores],
        "failures": [s.case for s in scores if s.is_failure],
    }
    (options.out / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    (options.out / "results.md").write_text(figures_table(figures, scores) + "\n" + failures_table(scores))
    try:
        plot(figures, scores, options.out / "results.svg")
    except ImportError as error:  # the figures are worth more than their picture
        print(f"blind: no results.svg: {error}", file=sys.stderr)
    print(json.dumps({**figures, "results": str(options.out / "results.json")}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
