"""The stages of finetuning, each with a file for its result: a stage with a result is not repeated.

recordings.txt    the recordings                                         (`diagnose_bags`)
patch.yaml        the effects found                                      (`diagnose_bags`)
episodes/*.json   scores, episode by episode, by cell
learned.json      training and distillation; weights/ has both policies  (`learning.train_and_distill`)
finetune.json     the summary so far                                     (`run_finetune`)
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event

import numpy as np
from sim2real.effects.patch import Patch, dump_patch, load_patch

from np_common.files import write_atomically
from np_common.parent_process import end_with_parent
from np_evaluation.calibration_corrections import corrections
from np_evaluation.finetune.learning import Learning, read_training_result, split_trainable, train_and_distill
from np_evaluation.finetune.rollouts import RolloutCell, run_all_rollouts, succeeds, text_of
from np_evaluation.finetune.shapley_values import (
    join_patches,
    mean_and_interval,
    shapley,
    split_patch,
    subsets,
    with_intervals,
)
from np_evaluation.finetune.summary import summarize
from np_record.bag import BagError, Recording

Turn = Callable[[], AbstractContextManager[int | None]]
"""Waits for a GPU and gives its number, None for the CPU, until its context is left."""


@dataclass(frozen=True)
class FinetuneSettings:
    """The robot to finetune for, and the evaluation."""

    robot: RolloutCell
    """The nominal robot in the simulator, with the policies to start from."""
    out: Path
    """Folder of all results."""
    reality: RolloutCell | None = None
    """A robot to judge by besides; None: that is the lab's."""
    episodes: int = 100
    """Of every figure."""
    share_episodes: int = 50
    """Of every subset of effects; 0: costs of single effects are not measured."""
    name: str = ""
    """Prefix of the progress shown."""
    beside: bool = False
    """Whether training begins at once, while episodes are played."""
    on_result: Callable[[dict], None] = lambda result: None
    """Called with the results so far after every stage."""
    is_over: Callable[[], bool] = lambda: False
    """Polled while training; True ends it."""

    def play(self, cells: dict[str, RolloutCell], episodes: int, what: str, pool: Executor) -> dict[str, list[float]]:
        """Scores of cells, kept in `out`."""
        return run_all_rollouts(cells, episodes, self.out / "episodes", pool, self.name + what)

    def with_patch(self, patch: Patch) -> RolloutCell:
        """The simulated robot with a patch."""
        return replace(self.robot, effects=text_of(patch))


def check_episodes(bags: Sequence[Path], domain: str) -> None:
    """Raises BagError for a recording of episodes of another domain: its keypoints are of another detector.

    A recording of `excite` is of the robot, whatever object lay there. A recording without a domain is accepted.
    """
    for bag in bags:
        with Recording(bag) as recording:
            information = recording.information
        if "experiments" not in information and information.get("domain", domain) != domain:
            raise BagError(
                f"bag {bag}: expected a recording of `excite`, or episodes of {domain}, got episodes of {information['domain']}"
            )


def diagnose_bags(bags: Sequence[Path], out: Path) -> Patch:
    """The patch that the diagnosis finds in recordings of the suites: `diagnose` of those of the arm, `diagnose_task` of those with keypoints.

    out/patch.yaml has both. Raises OSError where a diagnosis fails, with its message, and ValueError where `out` is of other recordings.
    """
    whole, of = out / "patch.yaml", out / "recordings.txt"
    given = "".join(f"{bag.resolve()}\n" for bag in sorted(bags))
    known = of.read_text(encoding="utf-8") if of.exists() else given
    if known != given and [*out.glob("patch.yaml"), *out.glob("*/patch.yaml")]:
        was = ", ".join(known.splitlines())
        raise ValueError(f"{out}: expected the recordings that it is of, {was}, got others: name another --out")
    out.mkdir(parents=True, exist_ok=True)
    write_atomically(of, given)
    if not whole.exists():
        seen = {bag: _has_keypoints(bag) for bag in bags}
        arm, task = ([str(bag) for bag in bags if seen[bag] == has] for has in (False, True))
        effects = ()
        if arm:
            effects += _diagnose("sim2real.cli.diagnose", arm, out / "arm")
        if task:
            effects += _diagnose(
                "sim2real.cli.diagnose_task", task, out / "task", ("--arm", str(out / "arm")) if arm else ()
            )
        whole.write_text(dump_patch(Patch(effects)), encoding="utf-8")
    return load_patch(whole)


def _has_keypoints(bag: Path) -> bool:
    with Recording(bag) as recording:
        return bool(recording.rows("keypoints").get("keypoints"))


def _diagnose(module: str, bags: Sequence[str], out: Path, options: Sequence[str] = ()) -> tuple:
    """Effects of the patch that a diagnosis writes into `out`, or has written before."""
    if not (out / "patch.yaml").exists():
        command = [sys.executable, "-m", module, *bags, "--out", str(out), *options]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, preexec_fn=end_with_parent)
        if done.returncode:
            raise OSError(f"{module.rpartition('.')[2]} refuses: {done.stdout.strip().splitlines()[-1:]}")
    return load_patch(out / "patch.yaml").effects


def run_finetune(
    what: FinetuneSettings, patch: Patch, how: Learning | None, pool: Executor, turn: Turn | None = None
) -> dict:
    """Evaluate with a patch, correct detector and driver for it, finetune the policies with the rest, and evaluate again.

    how: None: nothing is trained; turn: waits for a GPU, None: training begins at once on that of `how`. Returns the summary,
    which out/finetune.json keeps also of a run that ends early.
    """
    begun = time.monotonic()
    corrected = corrections(patch)
    trained_with = split_trainable(corrected.remaining)[0]
    corrected_for = "" if corrected.is_none else text_of(patch)

    def write_result(played: dict, costs: dict, learned: dict | None, after: dict) -> dict:
        reality = None if what.reality is None else what.reality.engine
        scores = {**played, **after}
        result = summarize(what.robot.domain, what.episodes, reality, patch, scores, costs, learned)
        result["wall_s"] = round(time.monotonic() - begun, 1)
        result["played"] = {name: [int(s) for s in succeeds(each)] for name, each in scores.items()}
        (what.out / "finetune.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        what.on_result(result)
        return result

    with _start_training(what, trained_with, how, turn) as learning:
        cells = {"nominal": what.robot, "patched": what.with_patch(patch)}
        if what.reality is not None:
            cells["reality"] = what.reality
        for name in ("patched", "reality") if corrected_for else ():
            if name in cells:
                cells[f"{name}_corrected"] = replace(cells[name], corrected=corrected_for)
        played = what.play(cells, what.episodes, "success before", pool)
        costs = _effect_costs(what, split_patch(patch), played, pool) if patch.effects and what.share_episodes else {}
        result = write_result(played, costs, None, {})
        if trained_with.effects and how is not None:
            new = learning()
            result = write_result(played, costs, new, _score_new_policies(what, patch, corrected_for, new, pool))
    return result


@contextmanager
def _start_training(
    what: FinetuneSettings, patch: Patch, how: Learning | None, turn: Turn | None
) -> Iterator[Callable[[], dict]]:
    """A function that waits for the training's result.

    The training begins at once with `what.beside`, else when the function is called. An interruption ends it; after another
    exception it runs to its end, and its result is kept.
    """
    interrupted = Event()

    def train() -> dict:
        if (known := read_training_result(what.out)) is not None:
            return known
        with (turn or (lambda: nullcontext(how.gpu)))() as gpu:
            return train_and_distill(
                what.robot.domain,
                patch,
                what.out,
                replace(how, gpu=gpu),
                what.robot.weights,
                lambda: interrupted.is_set() or what.is_over(),
            )

    if not (what.beside and how is not None and patch.effects):
        yield train
        return
    with ThreadPoolExecutor(1) as thread:
        learning = thread.submit(train)
        try:
            yield learning.result
        except BaseException as error:
            if not isinstance(error, Exception):
                interrupted.set()
            raise


def _score_new_policies(
    what: FinetuneSettings, patch: Patch, corrected_for: str, learned: dict, pool: Executor
) -> dict[str, list[float]]:
    """Scores of the new policies, with the new student and with the old one in the patched simulator; in reality with the
    better of the two."""
    places = {"new": learned["weights"], "old": learned["weights_old_student"]}
    patched = replace(what.with_patch(patch), corrected=corrected_for)
    cells = {f"patched_{student}_student": replace(patched, weights=place) for student, place in places.items()}
    played = what.play(cells, what.episodes, "success after", pool)
    learned["student"] = max(places, key=lambda student: sum(played[f"patched_{student}_student"]))
    learned["chosen"] = places[learned["student"]]
    played["patched_after"] = played[f"patched_{learned['student']}_student"]
    if what.reality is not None:
        reality = replace(what.reality, weights=learned["chosen"], corrected=corrected_for)
        cell = {f"reality_{learned['student']}_student": reality}
        (played["reality_after"],) = what.play(cell, what.episodes, "success after", pool).values()
    return played


def _effect_costs(what: FinetuneSettings, blamed: dict[str, Patch], played: dict, pool: Executor) -> dict[str, dict]:
    """Cost of each part of the patch in the patched simulator: its Shapley value in success and in score, and the score that
    returns without it alone."""
    names = list(blamed)
    count = min(what.share_episodes, what.episodes) if len(names) > 1 else what.episodes
    asked = {some: f"subset_{sum(1 << names.index(name) for name in some)}" for some in subsets(names)}
    cells = {
        label: what.with_patch(join_patches(blamed, some))
        for some, label in asked.items()
        if 0 < len(some) < len(names)
    }
    success = what.play(cells, count, "which effect", pool) if cells else {}
    success |= {asked[frozenset()]: played["nominal"][:count], asked[frozenset(names)]: played["patched"][:count]}
    scores = {some: np.array(success[label], float) for some, label in asked.items()}
    lost = with_intervals(shapley(names, {some: np.array(succeeds(each), float) for some, each in scores.items()}))
    # Where success is at 1 with every effect, only the score shows a difference between them.
    every = frozenset(names)
    taken = {name: mean_and_interval(scores[every - {name}] - scores[every]) for name in names}
    shares = with_intervals(shapley(names, scores))
    return {name: {**lost[name], "score": score, "taken_out": taken[name]} for name, score in shares.items()}
