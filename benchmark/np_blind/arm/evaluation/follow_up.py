"""The further recording that a diagnosis requests: made of the same arm, diagnosed, and judged."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from sim2real.excitation.suite import make_suite

from np_blind.arm.loop import make_targets, run_stable_arms
from np_blind.arm.sampling.cases import UNKNOWN_FAULT_KIND, ArmCase, make_physics
from np_blind.repository import relative

FOLDER = "next"
LATER = 600_000_000_000  # ns from the beginning of one recording to the next
STREAM = 4  # of the case's seeds: noise of its own


def suggested_experiment(folder: Path) -> str | None:
    """The experiment that a report in `folder` requests; None where it is sure, or states that none can
    help."""
    path = folder / "report.json"
    report = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    wanted = report.get("next_experiment") or {}
    return wanted.get("name") if report.get("verdict") == "ambiguous" and "command" in wanted else None


def follow_up(case: ArmCase, bag: Path, folder: Path, ask: Callable[[Sequence[Path], Path], str]) -> None:
    """Where the report in `folder` requests it, move the arm of a case again, and diagnose once more.

    ask(bags, folder) runs the diagnosis and returns what went wrong. The second report goes to folder/next.
    """
    from np_blind.arm.bags import write_bag  # slow: no --help should wait for it

    name = suggested_experiment(folder)
    if name is None:
        return
    second, answer = bag.with_name(f"{bag.name}_{FOLDER}"), folder / FOLDER
    shutil.rmtree(second, ignore_errors=True)
    answer.mkdir(parents=True, exist_ok=True)
    try:
        targets = make_targets(make_suite([name]))
    except ValueError as error:
        (answer / "error.txt").write_text(str(error))
        return
    record, _, lost = run_stable_arms(make_physics([case])[0], targets, [(*case.seed, STREAM)])
    if record is None:
        (answer / "error.txt").write_text(f"no second recording: the arm ran away after {lost[0]:.3f} s")
        return
    begin = int(np.random.default_rng([*case.seed, 3]).integers(1, 1000)) * 1_000_000_000 + LATER
    write_bag(second, record, 0, targets, begin, {"origin": "np_diagnosis blind test", "case": case.number})
    (answer / "error.txt").write_text(relative(ask([bag, second], answer)))
    shutil.rmtree(second)


def is_answered(entry: Mapping, folder: Path) -> bool | None:
    """Whether the second report is sure and right: `identified` with what the key holds and nothing else,
    `no_gap`
    of a clean arm, `unexplained` or `partly_explained` of a fault out of the catalogue. None where there was no second recording."""
    answer = folder / FOLDER
    if not (answer / "error.txt").exists():
        return None
    if (answer / "error.txt").read_text() or not (answer / "report.json").exists():
        return False
    try:
        report = json.loads((answer / "report.json").read_text(encoding="utf-8"))
    except ValueError:  # cut off while it was written
        return False
    verdicts = {"null": ("no_gap",), UNKNOWN_FAULT_KIND: ("unexplained", "partly_explained")}.get(entry["kind"])
    if verdicts is not None:
        return report["verdict"] in verdicts
    named = {(e["effect"], e["component"]) for e in report["effects"] if e["is_added"]}
    return report["verdict"] == "identified" and named == {(f["effect"], f["component"]) for f in entry["faults"]}


def could_settle(entry: Mapping, folder: Path) -> bool:
    """Whether the truth is one of the models that the experiment of the report in `folder` was to distinguish. Between models
    that are all wrong no experiment decides."""
    if suggested_experiment(folder) is None or entry["kind"] == UNKNOWN_FAULT_KIND:
        return False
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    wanted, faults = report["next_experiment"], [(f["effect"], f["component"]) for f in entry["faults"]]
    mine, *_ = sets = [() if text == "nothing" else tuple(text.split(" + ")) for text in wanted["separates"]]
    named = [(e["effect"], e["component"]) for e in report["effects"] if e["is_added"]]
    kept = [(effect, place) for effect, place in named if not (effect in mine and place == wanted["component"])]
    models = (Counter([*names, *(effect for effect, _ in kept)]) for names in sets)
    return set(kept) <= set(faults) and Counter(effect for effect, _ in faults) in models
