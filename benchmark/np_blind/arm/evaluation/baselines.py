"""What others' identification makes of the same cases (np_blind.baselines.methods), scored by the same rules.

A baseline fits a fixed list of parameters. To be scored like the diagnosis it is read as generously as
can be: what
it changes by at least the declared detection limit it names, the largest multiple first; nothing that large
is
`no_gap`; it never abstains and gives no intervals.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from np_blind.arm.evaluation.held_out_motion import heldout_gaps
from np_blind.arm.evaluation.patched_arm import PatchError, patched_physics, read_patch
from np_blind.arm.evaluation.scoring import Score, modules, score_case, score_gap, summary
from np_blind.arm.sampling.cases import ArmCase
from np_blind.arm.sampling.faults import EFFECTS, limit_of
from np_blind.repository import relative
from np_common.parent_process import end_with_parent
from np_description.panda import JOINT_NAMES

NAMES = ("none", "paper", "sysid_3", "sysid_6")
COMMAND = f"{shlex.quote(sys.executable)} -m np_blind.baselines.compare --threads 1"
KEYS = (
    "module_accuracy",
    "joint_accuracy",
    "effect_class_accuracy",
    "false_alarm",
    "abstain_out_of_catalogue",
    "pairs_top3",
    "shrink_vs_oracle",
    "shrink_absolute",
    "harm",
    "errors",
)
_FOLDER = "baselines"


def identify(bag: Path, folder: Path, command: str, timeout: float) -> None:
    """Run the baselines on a bag; patches, error.txt and seconds.json go to folder/baselines."""
    out = folder / _FOLDER
    out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    try:
        done = subprocess.run(
            [*shlex.split(command), str(bag.resolve()), "--out", str(out.resolve())],
            capture_output=True,
            text=True,
            timeout=timeout,
            preexec_fn=end_with_parent,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        error = "" if done.returncode == 0 else f"status {done.returncode}: {(done.stdout + done.stderr)[-2000:]}"
        if not error:
            (out / "fits.json").write_text(done.stdout.splitlines()[-1])
    except subprocess.TimeoutExpired:
        error = f"no answer within {timeout:g} s"
    (out / "seconds.json").write_text(json.dumps(round(time.monotonic() - began, 1)))
    (out / "error.txt").write_text(relative(error))


def as_report(patch: Sequence[Mapping]) -> dict:
    """A patch as a report of what it names: effects of at least their detection limit, largest first."""
    named = []
    for entry in patch:
        joint = JOINT_NAMES.index(entry["component"]) if entry["component"] in JOINT_NAMES else None
        if entry["effect"] in EFFECTS:
            size = np.linalg.norm(list(entry["parameters"].values())) / limit_of(entry["effect"], joint)
            named.append((float(size), entry))
    named = sorted((item for item in named if item[0] >= 1.0), key=lambda item: -item[0])
    return {
        "verdict": "identified" if named else "no_gap",
        "where": [{"module": modules()[e["effect"]], "component": e["component"]} for _, e in named],
        "effects": [
            {
                "effect": e["effect"],
                "component": e["component"],
                "probability": 1.0,
                "is_added": True,
                "parameters": {},
            }
            for _, e in named
        ],
    }


def score_baselines(
    entries: Sequence[Mapping],
    cases: Sequence[ArmCase],
    folders: Sequence[Path],
    parts: Sequence[Sequence[ArmCase]],
    pool: Executor,
) -> dict[str, dict]:
    """Figures of every baseline on the cases, by its name; entries: theirs of the key; parts: the cases, shared
    among processes. Raises ValueError where an earlier run left cases without baselines."""
    missing = [folder.name for folder in folders if not (folder / _FOLDER / "error.txt").exists()]
    if missing:
        raise ValueError(
            f"--baselines: expected all cases to be run with it, {', '.join(missing)} were not; name another --out"
        )
    read = {name: [_read(entry, folder, name) for entry, folder in zip(entries, folders)] for name in NAMES}
    first, followed = 0, []
    for part in parts:  # all baselines at once: it is the number of steps that takes the time
        patches = [patch for name in NAMES for _, patch in read[name][first : first + len(part)]]
        followed.append(pool.submit(heldout_gaps, list(part) * len(NAMES), patches))
        first += len(part)
    gaps: dict[str, list] = {name: [] for name in NAMES}
    for part, future in zip(parts, followed):
        for number, name in enumerate(NAMES):
            gaps[name] += future.result()[number * len(part) : (number + 1) * len(part)]
    figures = {}
    for name in NAMES:
        scores = [score for score, _ in read[name]]
        for score, gap in zip(scores, gaps[name]):
            score_gap(score, *gap)
        own = summary(scores)
        walls = [fits[name]["wall_s"] for f in folders if name in (fits := _fits(f))]
        figures[name] = {wanted: own[wanted] for wanted in KEYS} | {
            "wall_s_a_case": round(float(np.median(walls)), 1) if walls else None
        }
    seconds = [json.loads((f / _FOLDER / "seconds.json").read_text()) for f in folders]
    return figures | {"wall_s_a_case": round(float(np.median(seconds)), 1)}


def _read(entry: Mapping, folder: Path, name: str) -> tuple[Score, list[dict]]:
    """The score of a baseline's report on a case, and its patch; none where there is no report."""
    error, patch = (folder / _FOLDER / "error.txt").read_text(), []
    try:
        patch = read_patch(folder / _FOLDER / name / "patch.yaml") if not error else []
        patched_physics([patch])
    except (PatchError, KeyError, ValueError) as problem:
        error, patch = str(problem), []
    return score_case(entry, None if error else as_report(patch), error), patch


def _fits(folder: Path) -> dict:
    path = folder / _FOLDER / "fits.json"
    return json.loads(path.read_text()) if path.exists() else {}
