"""`simtest`: run the graph's nodes in one process, over a simulated network, clock and arm, under seeded random faults; guarantees must hold."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from np_common.cli import INTERRUPTED, Parser, Progress, interrupt_on_sigterm
from np_description.weights.provenance import origin

_WARM_UP = 5  # runs whose memory also grows by what is loaded once


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = Parser(prog="simtest", description=__doc__.partition(": ")[2])
    p.add_argument("--seeds", type=int, default=20, help="number of runs; %(default)s")
    p.add_argument("--first", type=int, default=0, help="the first seed; %(default)s")
    p.add_argument("--one", type=int, help="run this seed alone and print its log; a failing run is shrunk")
    p.add_argument("--over-dds", action="store_true", help="also run each seed as processes over DDS, and compare")
    p.add_argument("--seconds", type=float, default=float("inf"), help="start no run after this wall time, s")
    p.add_argument("--out", type=Path, help="file that receives one line of JSON per run")
    return p


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object. Status 1: a guarantee was broken."""
    options = parser().parse_args(arguments)
    interrupt_on_sigterm()
    try:
        if options.over_dds:
            return _compare_all(options)
        return _run_one(options.one) if options.one is not None else _run_all(options)
    except KeyboardInterrupt:
        return INTERRUPTED


def _run_all(options: argparse.Namespace) -> int:
    from np_evaluation.endurance.resources import measure_use
    from np_evaluation.simtest.plan import Plan
    from np_evaluation.simtest.shrink import play

    began, faults, memory = time.monotonic(), Counter(), []

    def run(seed: int) -> dict[str, object]:
        report = play(Plan.of(seed))
        faults.update(fault.kind for fault in report.plan.faults)
        memory.append(measure_use("self").memory)
        for kind, text in report.violations.items():
            print(f"simtest: seed {seed}: {kind}: {text}", file=sys.stderr)
        return report.summarize()

    reports = _run_each_seed(options, run)
    processor = sum(report["processor_s"] for report in reports)
    result = {
        "runs": len(reports),
        "first_seed": options.first,
        "faults_injected": sum(faults.values()),
        "faults": dict(sorted(faults.items())),
        "violations": dict(Counter(kind for report in reports for kind in report["violations"])),
        "failing_seeds": [report["seed"] for report in reports if report["violations"]],
        "realtime_factor": round(sum(report["simulated_s"] for report in reports) / processor, 2),
        "memory_kB_per_run": _fit_slope(memory),
        "revision": origin()["revision"],
        "wall_s": round(time.monotonic() - began, 1),
    }
    print(json.dumps(result))
    return 1 if result["failing_seeds"] else 0


def _compare_all(options: argparse.Namespace) -> int:
    from np_evaluation.simtest.fidelity import compare
    from np_evaluation.simtest.plan import Plan

    def run(seed: int) -> dict[str, object]:
        row, log = compare(Plan.of(seed))
        if options.one is not None:
            print("\n".join(log))
        return row

    began, rows = time.monotonic(), _run_each_seed(options, run)
    result = {
        "scripts": len(rows),
        "faults_played": sum(len(row["faults"]) for row in rows),
        "faults_left_out": dict(sorted(Counter(kind for row in rows for kind in row["left_out"]).items())),
        "same_as_drawn": sum(not row["differs_as_drawn"] for row in rows),
        "same_at_other_times": sum(bool(row["differs_as_drawn"] and not row["differs"]) for row in rows),
        "differing": {row["seed"]: row["differs"] for row in rows if row["differs"]},
        "broken_over_dds": {row["seed"]: row["violations"] for row in rows if row["violations"]},
        "revision": origin()["revision"],
        "wall_s": round(time.monotonic() - began, 1),
    }
    print(json.dumps(result))
    return 1 if result["broken_over_dds"] else 0


def _run_each_seed(options: argparse.Namespace, run: Callable[[int], dict[str, object]]) -> list[dict[str, object]]:
    """Call `run` for each requested seed; returns the rows and appends them to the requested file."""
    began, rows = time.monotonic(), []
    seeds = range(options.first, options.first + options.seeds) if options.one is None else [options.one]
    progress = Progress(len(seeds), "simtest")
    for number, seed in enumerate(seeds):
        if time.monotonic() - began > options.seconds:
            break
        progress.show(number)
        rows.append(run(seed))
        if options.out is not None:
            with options.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    progress.show(len(seeds))
    return rows


def _run_one(seed: int) -> int:
    from np_evaluation.simtest.plan import Plan
    from np_evaluation.simtest.shrink import play, shrink

    report = play(Plan.of(seed))
    print("\n".join(report.log))
    if report.violations:
        shorter = shrink(report)
        print(f"\nshrunk from {len(report.plan.faults)} faults to {len(shorter.plan.faults)}:")
        print("\n".join(shorter.log))
        report = shorter
    print(json.dumps({**report.summarize(), "faults": [str(fault) for fault in report.plan.faults]}))
    return 1 if report.violations else 0


def _fit_slope(memory: list[int]) -> float | None:
    """Fit the growth of memory per run, kB, after the warm-up; None for fewer than ten runs."""
    import numpy as np

    kept = memory[_WARM_UP:]
    return round(float(np.polyfit(range(len(kept)), kept, 1)[0]), 1) if len(kept) >= 10 else None


if __name__ == "__main__":
    raise SystemExit(main())
