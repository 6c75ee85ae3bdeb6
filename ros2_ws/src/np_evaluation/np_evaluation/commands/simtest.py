"""`simtest`: the graph's nodes in one process, over a simulated network, clock and arm, under faults that a seed draws; what is promised has to hold."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from np_common.cli import INTERRUPTED, Parser, Progress, interrupt_on_sigterm
from np_description.weights.provenance import origin

_WARM = 5  # runs until what is loaded once is loaded


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = Parser(prog="simtest", description=__doc__.partition(": ")[2])
    p.add_argument("--seeds", type=int, default=20, help="how many runs; %(default)s")
    p.add_argument("--first", type=int, default=0, help="the first seed; %(default)s")
    p.add_argument("--one", type=int, help="only this seed, with its log; one that fails is made as short as it goes")
    p.add_argument("--seconds", type=float, default=float("inf"), help="begin no run after so many s of wall time")
    p.add_argument("--out", type=Path, help="file for a line of JSON about each run")
    return p


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object. Status 1: a promise was broken."""
    options = parser().parse_args(arguments)
    interrupt_on_sigterm()
    try:
        return _run_one(options.one) if options.one is not None else _run_all(options)
    except KeyboardInterrupt:
        return INTERRUPTED


def _run_all(options: argparse.Namespace) -> int:
    from np_evaluation.endurance.resources import measure_use
    from np_evaluation.simtest.plan import Plan
    from np_evaluation.simtest.run import Run

    began, reports, faults, memory = time.monotonic(), [], Counter(), []
    progress = Progress(options.seeds, "simtest")
    for number in range(options.seeds):
        if time.monotonic() - began > options.seconds:
            break
        progress.show(number)
        with tempfile.TemporaryDirectory() as folder:
            report = Run(Plan.of(options.first + number), Path(folder)).play()
        reports.append(report.figures())
        faults.update(fault.kind for fault in report.plan.faults)
        memory.append(measure_use("self").memory)
        if options.out is not None:
            with options.out.open("a") as file:
                file.write(json.dumps(reports[-1]) + "\n")
        for kind, text in report.violations.items():
            print(f"simtest: seed {report.plan.seed}: {kind}: {text}", file=sys.stderr)
    progress.show(options.seeds)
    processor = sum(report["processor_s"] for report in reports)
    result = {
        "runs": len(reports),
        "first_seed": options.first,
        "faults_injected": sum(faults.values()),
        "faults": dict(sorted(faults.items())),
        "violations": dict(Counter(kind for report in reports for kind in report["violations"])),
        "failing_seeds": [report["seed"] for report in reports if report["violations"]],
        "realtime_factor": round(sum(report["simulated_s"] for report in reports) / processor, 2),
        "memory_kB_per_run": _slope(memory),
        "revision": origin()["revision"],
        "wall_s": round(time.monotonic() - began, 1),
    }
    print(json.dumps(result))
    return 1 if result["failing_seeds"] else 0


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
    print(json.dumps({**report.figures(), "faults": [str(fault) for fault in report.plan.faults]}))
    return 1 if report.violations else 0


def _slope(memory: list[int]) -> float | None:
    """kB a run by a line through the runs after the first few; None for too few of them."""
    import numpy as np

    kept = memory[_WARM:]
    return round(float(np.polyfit(range(len(kept)), kept, 1)[0]), 1) if len(kept) >= 10 else None


if __name__ == "__main__":
    raise SystemExit(main())
