"""`blind`: the doctor against arms whose cause is sealed (docs/blind_test.md).

Makes the bags, runs `diagnose` on each in a process of its own, then opens the key, checks its hash, and
scores. The last line printed is one JSON object. It needs no ROS.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

from np_diagnosis.blind import others
from np_diagnosis.blind.cases import Case, draw_cases
from np_diagnosis.blind.followup import follow_up, is_settled
from np_diagnosis.blind.generate import add_options, bag_path, batches, make_bags
from np_diagnosis.blind.heldout import heldout_gaps
from np_diagnosis.blind.patched import PatchError, patched_physics, read_patch
from np_diagnosis.blind.processes import end_with_parent, workers
from np_diagnosis.blind.progress import Bar
from np_diagnosis.blind.scoring import Score, score_case, score_gap, summary
from np_diagnosis.blind.sealed import SealError, check, digest, make_key, seal
from np_diagnosis.blind.tables import failures_table, figures_table, plot

DOCTOR = f"{shlex.quote(sys.executable)} -m np_diagnosis.commands.diagnose"
SINGLE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command line."""
    parser = argparse.ArgumentParser(prog="blind", description=__doc__.split("\n")[0])
    add_options(parser, "locked")
    parser.add_argument("--out", type=Path, help="folder; what is there already is not done again "
                        "(default: runs/blind/SET_CASES_SEED)")
    parser.add_argument("--seal", action="store_true", help="only put down the key's hash, to be committed")
    parser.add_argument("--keep", action="store_true", help="keep the bags")
    parser.add_argument("--doctor", default=DOCTOR, help="command that is given BAG --out FOLDER")
    parser.add_argument("--baselines", action="store_true", help="beside the doctor: the paper's identification, "
                        "mujoco.sysid and no fix (ten minutes and more of CPU a case)")
    parser.add_argument("--identify", default=others.COMMAND, help="command of the baselines")
    parser.add_argument("--timeout", type=float, default=3600.0, help="s of wall time for one case")
    options = parser.parse_args(arguments)
    if options.cases < 1 or options.jobs < 1:
        parser.error("--cases, --jobs: expected at least 1")
    options.out = options.out or Path("runs/blind") / f"{options.which}_{options.cases}_{options.seed}"
    return options


def diagnose(case: Case, out: Path, doctor: str, timeout: float, keep: bool, identify: str) -> int:
    """Run the doctor, and `identify` unless it is empty, on the bag of a case; what they say goes to
    reports/case_*. The number of the case."""
    bag, folder = bag_path(out, case.number), report_path(out, case.number)
    folder.mkdir(parents=True, exist_ok=True)

    def ask(bags: Sequence[Path], answer: Path) -> str:
        command = [*shlex.split(doctor), *(str(b.resolve()) for b in bags), "--out", str(answer.resolve())]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=timeout,
                                  preexec_fn=end_with_parent, env={**os.environ, **SINGLE_THREAD})
        except subprocess.TimeoutExpired:
            return f"no answer within {timeout:g} s"
        return "" if done.returncode == 0 else f"status {done.returncode}: {(done.stdout + done.stderr)[-2000:]}"

    error = ask([bag], folder)
    follow_up(case, bag, folder, ask)
    if identify:
        others.identify(bag, folder, identify, timeout)
    write_error(out, case.number, error)
    if not keep:
        shutil.rmtree(bag)
    return case.number


def report_path(out: Path, number: int) -> Path:
    """Folder of the doctor's answer to a case; it holds error.txt once the doctor has run."""
    return out / "reports" / f"case_{number:03d}"


def write_error(out: Path, number: int, error: str) -> None:
    """Put down that a case is done, and what went wrong."""
    folder = report_path(out, number)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "error.txt").write_text(error)


def run_doctor(options: argparse.Namespace, pool: ProcessPoolExecutor) -> None:
    """Bags and reports of all cases that have none yet."""
    cases = draw_cases(options.cases, options.seed, options.which)
    answered = {c.number for c in cases if (report_path(options.out, c.number) / "error.txt").exists()}
    recorded = {c.number for c in cases
                if (bag_path(options.out, c.number) / "metadata.yaml").exists()} - answered
    missing = [c for c in cases if c.number not in answered | recorded]
    for case in missing:  # cut off while it was written
        shutil.rmtree(bag_path(options.out, case.number), ignore_errors=True)
    asked = options.out.resolve(), options.doctor, options.timeout, options.keep, \
        options.identify if options.baselines else ""
    bar = Bar(len(cases), f"blind {options.which} {options.seed}")
    making = {pool.submit(make_bags, batch, options.only, options.out.resolve())
              for batch in batches(missing, options.jobs)} if missing else set()
    asking = {pool.submit(diagnose, cases[number], *asked) for number in sorted(recorded)}
    done = len(answered)
    bar.show(done, "simulating")
    for future in as_completed(making):
        for number, error in future.result().items():
            if error:  # counted as wrong: no answer
                write_error(options.out, number, error)
                done += 1
            else:
                asking.add(pool.submit(diagnose, cases[number], *asked))
    for future in as_completed(asking):
        future.result()
        done += 1
        bar.show(done, "diagnosed")


def score(options: argparse.Namespace, key: str, pool: ProcessPoolExecutor) -> list[Score]:
    """Open the key and score every case."""
    scores, patches, followed = [], [], []
    for entry in json.loads(key)["cases"]:
        folder = report_path(options.out, entry["case"])
        error, report = (folder / "error.txt").read_text(), None
        try:
            report = json.loads((folder / "report.json").read_text()) if not error else None
            patch = read_patch(folder / "patch.yaml") if report else []
            patched_physics([patch])
        except (OSError, PatchError, KeyError, ValueError) as problem:
            error, patch = error or str(problem), []
        scores.append(score_case(entry, report, error))
        scores[-1].settled = is_settled(entry, folder)
        patches.append(patch)
    cases = draw_cases(options.cases, options.seed, options.which)
    parts = batches(cases, options.jobs)
    first = 0
    for part in parts:
        followed.append(pool.submit(heldout_gaps, part, patches[first:first + len(part)]))
        first += len(part)
    gaps = [gap for future in followed for gap in future.result()]
    for case_score, gap in zip(scores, gaps):
        score_gap(case_score, *gap)
    return scores


def score_baselines(options: argparse.Namespace, key: str, pool: ProcessPoolExecutor) -> dict[str, dict]:
    """Figures of the baselines. Raises ValueError where an earlier run left cases without them."""
    cases = draw_cases(options.cases, options.seed, options.which)
    folders = [report_path(options.out, case.number) for case in cases]
    missing = [f.name for f in folders if not (f / "baselines" / "error.txt").exists()]
    if missing:
        raise ValueError(f"--baselines: expected all cases to be run with it, {', '.join(missing)} were not; "
                         "name another --out")
    return others.score_others(json.loads(key), cases, folders, batches(cases, options.jobs), pool)


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    options = parse(arguments)
    began = time.monotonic()
    try:
        if options.seal:
            print(json.dumps({"key_sha256": seal(options.cases, options.seed, options.which)}))
            return 0
        key = make_key(options.cases, options.seed, options.which)
        sealed = check(key) if options.which == "locked" else digest(key)
        options.out.mkdir(parents=True, exist_ok=True)
        with workers(options.jobs) as pool:
            run_doctor(options, pool)
            (options.out / "key.json").write_text(key)
            scores = score(options, key, pool)
            beside = score_baselines(options, key, pool) if options.baselines else {}
    except (SealError, ValueError, OSError) as error:
        print(f"blind: {error}", file=sys.stderr)
        return 1
    figures = {**summary(scores), "set": options.which, "seed": options.seed, "key_sha256": sealed,
               **({"baselines": beside} if beside else {}),
               "wall_s": round(time.monotonic() - began, 1)}
    results = {"figures": figures, "cases": [asdict(s) for s in scores],
               "failures": [s.case for s in scores if s.is_failure]}
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
