"""Evaluation of withheld robots in PhysX: recording, diagnosis, fine-tuning and success. Each stage keeps a file and is not repeated where it exists."""

from __future__ import annotations

import json
import shutil
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Queue
from threading import Event

import numpy as np
from sim2real.effects.patch import Patch, dump_patch, load_patch

from np_blind.repository import relative
from np_blind.robots.cases import Robot
from np_common.cli import Progress
from np_common.files import write_atomically
from np_evaluation.calibration_corrections import corrections
from np_evaluation.finetune.learning import Learning, split_trainable
from np_evaluation.finetune.rollouts import CachedScores, RolloutCell, run_all_rollouts, succeeds, text_of
from np_evaluation.finetune.stages import FinetuneSettings, run_finetune
from np_evaluation.finetune.summary import KEPT

SUITES = 2  # recordings of the task suite, in which the object lies elsewhere
TASKS = 900  # seed of the tasks by which robots are judged
ORACLES = ("all", "corrected", "none")  # robots for which the same is done with the true effects
RESULT_KEYS = (
    "cause",
    "costs",
    "kept",
    "corrected",
    "not_trained",
    "success",
    "lost",
)  # of a fine-tuning, kept in a row


class GpuPool:
    """Lends GPU numbers, each to `per_gpu` trainings at a time; None is lent where there is no GPU."""

    def __init__(self, gpus: Sequence[int | None], per_gpu: int = 1):
        self._free: Queue[int | None] = Queue()
        for gpu in [gpu for _ in range(per_gpu) for gpu in (gpus or [None])]:
            self._free.put(gpu)

    @contextmanager
    def __call__(self) -> Iterator[int | None]:
        """Wait for a GPU; its number."""
        gpu = self._free.get()
        try:
            yield gpu
        finally:
            self._free.put(gpu)


@dataclass(frozen=True)
class EvaluationConfig:
    """How robots are evaluated."""

    out: Path
    """Folder of all results."""
    seed: int
    """Seed of the set."""
    episodes: int
    """Episodes of every figure."""
    share_episodes: int
    """Episodes of every subset of the effects that were found."""
    how: Learning | None
    """Training; None evaluates corrections only."""
    oracle: str = "all"
    """One of ORACLES; `corrected` are robots for which no training is needed."""
    interrupted: Event = field(default_factory=Event, compare=False)
    """Set to end trainings that run."""

    def asks_oracle(self, robot: Robot) -> bool:
        """Whether the same is done with a robot's true effects."""
        if self.oracle == "all" and self.how is not None:
            return True
        return self.oracle != "none" and not self.trains(robot.patch)

    def trains(self, patch: Patch) -> bool:
        """Whether policies are trained for anything in a patch."""
        return bool(split_trainable(corrections(patch).remaining)[0].effects)


def nominal_success(domains: Sequence[str], config: EvaluationConfig, pool: Executor) -> dict[str, list[float]]:
    """Scores of the released policies on the nominal robot, in both engines, by names such as `wall_mujoco`."""
    cells = {f"{d}_{e}": RolloutCell(d, e, seed=TASKS) for d in domains for e in ("mujoco", "physx")}
    return run_all_rollouts(cells, config.episodes, config.out / "nominal", pool, "nominal")


def evaluate_robots(robots: Sequence[Robot], config: EvaluationConfig, pool: Executor, gpus: GpuPool) -> list[dict]:
    """A row for each robot; robots are evaluated side by side."""
    progress, threads = Progress(len(robots), "robots"), ThreadPoolExecutor(len(robots) + 1)
    progress.show(0)
    try:
        domains = sorted({robot.domain for robot in robots})
        nominal = threads.submit(nominal_success, domains, config, pool)
        ordered = sorted(robots, key=lambda robot: not config.trains(robot.patch))  # trainings take longest
        rows = {threads.submit(evaluate_robot, robot, config, nominal, pool, gpus): robot.number for robot in ordered}
        for number, _ in enumerate(as_completed(rows), 1):
            progress.show(number)
    except BaseException:
        config.interrupted.set()
        raise
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
    found = {number: future.result() for future, number in rows.items()}
    return [found[robot.number] for robot in robots]


def evaluate_robot(robot: Robot, config: EvaluationConfig, nominal: Future, pool: Executor, gpus: GpuPool) -> dict:
    """The row of a robot, written after every stage; an error is a row too. A row that is complete is read."""
    file = config.out / robot.folder / "row.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    if known.get("episodes") == config.episodes and not known.get("error"):
        return known
    row = {"robot": robot.number, "domain": robot.domain, "truth": dump_patch(robot.patch)}
    row |= {"episodes": config.episodes, "error": "not finished"}

    def keep() -> None:
        write_atomically(file, json.dumps(row, indent=1) + "\n")

    try:
        _evaluate(row, keep, robot, config, nominal, pool, gpus)
        del row["error"]
    except Exception:
        row["error"] = relative(traceback.format_exc(limit=3))
    keep()
    return row


def _evaluate(row: dict, keep: Callable[[], None], robot: Robot, config, nominal, pool: Executor, gpus) -> None:
    with ThreadPoolExecutor(1) as beside:
        without = beside.submit(without_each, robot, config, pool)
        patch, row["diagnosis"] = _diagnose(robot, config, pool)
        row["found"] = dump_patch(patch)
        keep()
        believed = succeeds(nominal.result()[f"{robot.domain}_physx"])

        def on_result(result: dict) -> None:
            row.update({name: result[name] for name in RESULT_KEYS})
            row["engine"] = {**row.get("engine", {}), "nominal": believed, "before": result["played"]["reality"]}
            row["took_s"] = result["wall_s"]
            keep()

        try:
            what = _finetuning(robot, config, config.out / robot.folder, on_result)
            result = run_finetune(what, patch, config.how, pool, gpus)
            row["engine"] |= _after(result)
            keep()
        finally:
            if "engine" in row:  # also where training died
                row |= ablations(robot, config, nominal.result()[f"{robot.domain}_physx"], without.result())
                keep()
        if config.asks_oracle(robot):
            what = _finetuning(robot, config, config.out / robot.folder / "oracle")
            row["engine"]["oracle"] = _after(run_finetune(what, robot.patch, config.how, pool, gpus))["adopted"]


def _diagnose(robot: Robot, config: EvaluationConfig, pool: Executor) -> tuple[Patch, dict]:
    from np_blind.robots.recording import diagnose_robot, record_arm_physx, record_task_physx  # slow to import

    folder = config.out / robot.folder
    summary, found = folder / "diagnosis.json", folder / "patch.yaml"
    if not summary.exists():
        begun = time.monotonic()
        seed = 1000 * config.seed + 10 * robot.number
        asked = [pool.submit(record_arm_physx, robot.patch, seed)]
        asked += [pool.submit(record_task_physx, robot.patch, seed + number) for number in range(SUITES)]
        recorded, refused = [], []
        for future in asked:
            try:
                recorded.append(future.result())
            except BrokenExecutor:
                raise
            except RuntimeError as error:  # the suite's guard ends it, as it would a lab's
                recorded.append(None)
                refused.append(str(error))
        log, *tasks = recorded
        patch, verdicts = pool.submit(diagnose_robot, log, [task for task in tasks if task is not None]).result()
        verdicts |= {"not_recorded": refused, "took_s": round(time.monotonic() - begun, 1)}
        found.write_text(dump_patch(patch), encoding="utf-8")
        summary.write_text(json.dumps(verdicts, indent=1), encoding="utf-8")
    return load_patch(found), json.loads(summary.read_text(encoding="utf-8"))


def reality_of(robot: Robot) -> RolloutCell:
    """The robot itself, in PhysX."""
    return RolloutCell(robot.domain, "physx", text_of(robot.patch), seed=TASKS)


def _finetuning(robot: Robot, config: EvaluationConfig, folder: Path, on_result=None) -> FinetuneSettings:
    """In a folder, to which episodes are copied that were played already: the nominal robot is the same for all. on_result: None for the oracle,
    whose effects are not blamed."""
    (folder / "episodes").mkdir(parents=True, exist_ok=True)
    known = {
        "nominal": config.out / "nominal" / f"{robot.domain}_mujoco.json",
        "reality": config.out / robot.folder / "episodes" / "reality.json",
    }
    for name, there in known.items():
        own = folder / "episodes" / f"{name}.json"
        if not own.exists() and there.exists():
            shutil.copyfile(there, own)
    return FinetuneSettings(
        RolloutCell(robot.domain, seed=TASKS),
        folder,
        reality_of(robot),
        config.episodes,
        config.share_episodes if on_result else 0,
        name=f"{robot.folder} " if on_result else f"{robot.folder} oracle ",
        beside=True,
        on_result=on_result or (lambda result: None),
        is_over=config.interrupted.is_set,
    )


def without_each(robot: Robot, config: EvaluationConfig, pool: Executor) -> dict[str, list[float]]:
    """Scores of the old policies in PhysX without each of the true effects, where there are several."""
    effects, reality = robot.patch.effects, reality_of(robot)
    others = {e.effect: Patch(tuple(other for other in effects if other is not e)) for e in effects if len(effects) > 1}
    cells = {f"without_{name}": replace(reality, effects=text_of(patch)) for name, patch in others.items()}
    folder = config.out / robot.folder / "episodes"
    played = run_all_rollouts(cells, config.episodes, folder, pool, f"{robot.folder} without" if cells else "")
    return {name: played[f"without_{name}"] for name in others}


def ablations(
    robot: Robot, config: EvaluationConfig, nominal: Sequence[float], without: Mapping[str, Sequence[float]]
) -> dict[str, dict[str, float]]:
    """What each true effect costs in PhysX, as `ablation` of success and `ablation_scores`: without it, less with all. Scores: nominal, and
    without each of several; those with all are kept."""
    kept = CachedScores(config.out / robot.folder / "episodes", {"reality": reality_of(robot)})
    before = kept.of("reality", config.episodes)
    others = without or {robot.effects[0].effect: nominal}
    return {
        "ablation": {n: float(np.mean(succeeds(each)) - np.mean(succeeds(before))) for n, each in others.items()},
        "ablation_scores": {n: float(np.mean(each) - np.mean(before)) for n, each in others.items()},
    }


def _after(summary: dict) -> dict[str, list[int] | None]:
    """Success in PhysX with what a rehearsal has come to: corrected, after training, and of what it keeps, None where there is none."""
    played = summary["played"]
    return {
        "corrected": played.get("reality_corrected"),
        "after": played.get("reality_after"),
        "adopted": played[KEPT[summary["kept"]].replace("patched", "reality")],
    }
