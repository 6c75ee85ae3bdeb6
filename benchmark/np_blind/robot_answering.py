"""A withheld robot recorded, diagnosed, rehearsed and judged in PhysX. Each stage has a file, and is not done again where that is there."""

from __future__ import annotations

import json
import shutil
import time
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Condition

from np_blind.robot_cases import Robot
from np_bringup.rehearsal.learning import Learning
from np_bringup.rehearsal.playing import Cell, play_all, text_of
from np_bringup.rehearsal.stages import Rehearsal, rehearse
from np_effects.patch import Patch, dump_patch, load_patch
from np_record.command import Progress

SUITES = 2  # recordings of the task suite, in which the object lies elsewhere
TASKS = 900  # seed of the tasks by which robots are judged


class Turns:
    """GPUs of which each, or the CPU where there is none, trains `each` at a time; who may be last waits until nobody else does."""

    def __init__(self, there: Sequence[int | None], each: int = 1):
        self._free = [gpu for _ in range(each) for gpu in (there or [None])]
        self._first, self._changed = 0, Condition()

    @contextmanager
    def __call__(self, last: bool = False) -> Iterator[int | None]:
        """Wait for a turn; the GPU's number."""
        with self._changed:
            self._first += not last
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._free and not (last and self._first))
            self._first -= not last
            gpu = self._free.pop(0)
            self._changed.notify_all()
        try:
            yield gpu
        finally:
            with self._changed:
                self._free.append(gpu)
                self._changed.notify_all()


class TimeOver(Exception):
    """No further stage is begun."""


@dataclass(frozen=True)
class Judging:
    """How robots are judged. seed: of the set; episodes, share_episodes: of every figure, and of every subset of the effects found; how:
    training; oracle: whether the same is done with the true effects; until: Unix s from which no stage is begun; out: folder."""

    out: Path
    seed: int
    episodes: int
    share_episodes: int
    how: Learning
    oracle: bool = True
    until: float = float("inf")

    def check(self) -> None:
        """Raises TimeOver."""
        if time.time() > self.until:
            raise TimeOver


def nominal_success(domains: Sequence[str], judging: Judging, pool: Executor) -> dict[str, list[bool]]:
    """Success of the released policies on the robot that is believed in, in both engines, as `wall_mujoco`."""
    cells = {f"{d}_{e}": Cell(d, e, seed=TASKS) for d in domains for e in ("mujoco", "physx")}
    return play_all(cells, judging.episodes, judging.out / "nominal", pool, "nominal")


def settle_all(robots: Sequence[Robot], judging: Judging, pool: Executor, turn: Turns) -> list[dict]:
    """A row for each robot, as far as the time went; robots side by side."""
    nominal = nominal_success(sorted({robot.domain for robot in robots}), judging, pool)
    progress, rows = Progress(len(robots), "robots"), []
    progress.show(0)
    with ThreadPoolExecutor(len(robots)) as threads:
        for future in [threads.submit(settle, robot, judging, nominal, pool, turn) for robot in robots]:
            rows.append(future.result())
            progress.show(len(rows))
    return rows


def answered(robots: Sequence[Robot], judging: Judging) -> list[dict]:
    """The rows that are there."""
    kept = (judging.out / robot.folder / "row.json" for robot in robots)
    return [json.loads(path.read_text(encoding="utf-8")) for path in kept if path.exists()]


def settle(robot: Robot, judging: Judging, nominal: dict[str, list[bool]], pool: Executor, turn: Turns) -> dict:
    """The row of a robot: what is known of it when the time is over, or all; what goes wrong is in it too."""
    row = {"robot": robot.number, "domain": robot.domain, "truth": dump_patch(robot.patch)}
    try:
        _settle(row, robot, judging, nominal, pool, turn)
    except TimeOver:
        row["error"] = "the time was over"
    except Exception:
        row["error"] = traceback.format_exc(limit=3)
    folder = judging.out / robot.folder
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "row.json").write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
    return row


def _settle(row: dict, robot: Robot, judging: Judging, nominal, pool: Executor, turn: Turns) -> None:
    """What asks no doctor is done beside: PhysX with the old policies, and the oracle's training, which lets the others go first."""
    believed = nominal[f"{robot.domain}_physx"]
    judging.check()
    with ThreadPoolExecutor(2) as beside:
        ablated = beside.submit(_before, robot, judging, believed, pool)
        oracle = beside.submit(_oracle, robot, judging, ablated, pool, turn) if judging.oracle else None
        patch, row["diagnosis"] = _diagnosed(robot, judging, pool)
        row["found"] = dump_patch(patch)
        before, row["ablation"] = ablated.result()
        row["engine"] = {"nominal": believed, "before": before}
        what = _rehearsal(robot, judging, judging.out / robot.folder)
        told = rehearse(what, patch, judging.how, pool, turn)
        after = told["played"].get("reality_after")
        row |= {name: told[name] for name in ("cause", "costs", "adopted", "not_trained", "success", "lost")}
        row["engine"] |= {"after": after, "adopted": after if told["adopted"] else before}
        row["took_s"] = told["wall_s"]
        if oracle is not None:
            row["engine"]["oracle"] = oracle.result()


def _diagnosed(robot: Robot, judging: Judging, pool: Executor) -> tuple[Patch, dict]:
    from np_blind.robot_recording import diagnosis, recorded_arm, recorded_task  # slow to import

    folder = judging.out / robot.folder
    told, found = folder / "diagnosis.json", folder / "patch.yaml"
    if not told.exists():
        begun = time.monotonic()
        seed = 1000 * judging.seed + 10 * robot.number
        log = pool.submit(recorded_arm, robot.patch, seed)
        tasks = [pool.submit(recorded_task, robot.patch, seed + number) for number in range(SUITES)]
        patch, said = pool.submit(diagnosis, log.result(), [task.result() for task in tasks]).result()
        folder.mkdir(parents=True, exist_ok=True)
        found.write_text(dump_patch(patch), encoding="utf-8")
        told.write_text(json.dumps({**said, "took_s": round(time.monotonic() - begun, 1)}, indent=1), encoding="utf-8")
    return load_patch(found), json.loads(told.read_text(encoding="utf-8"))


def _reality(robot: Robot) -> Cell:
    return Cell(robot.domain, "physx", text_of(robot.patch), seed=TASKS)


def _rehearsal(robot: Robot, judging: Judging, folder: Path, shares: bool = True) -> Rehearsal:
    """In a folder, in which episodes lie that others have played already: what is believed in is the same for all robots."""
    (folder / "episodes").mkdir(parents=True, exist_ok=True)
    known = {
        "nominal": judging.out / "nominal" / f"{robot.domain}_mujoco.json",
        "reality": judging.out / robot.folder / "episodes" / "reality.json",
    }
    for name, there in known.items():
        own = folder / "episodes" / f"{name}.json"
        if not own.exists() and there.exists():
            shutil.copyfile(there, own)
    name = robot.folder if shares else f"{robot.folder} oracle"
    return Rehearsal(
        Cell(robot.domain, seed=TASKS),
        folder,
        _reality(robot),
        judging.episodes,
        judging.share_episodes if shares else 0,
        name=f"{name} ",
        go_on=judging.check,
    )


def _before(robot: Robot, judging: Judging, believed, pool: Executor) -> tuple[list[bool], dict[str, float]]:
    """Success of the old policies in PhysX, and what each true effect costs there: success without it, less success with all."""
    effects, reality = robot.patch.effects, _reality(robot)
    others = {e.effect: Patch(tuple(other for other in effects if other is not e)) for e in effects if len(effects) > 1}
    cells = {f"without_{name}": replace(reality, effects=text_of(patch)) for name, patch in others.items()}
    folder = judging.out / robot.folder / "episodes"
    played = play_all({"reality": reality, **cells}, judging.episodes, folder, pool, f"{robot.folder} before")
    before = played["reality"]
    without = {name: played[f"without_{name}"] for name in others} or {effects[0].effect: believed}
    return before, {name: (sum(each) - sum(before)) / len(before) for name, each in without.items()}


def _oracle(robot: Robot, judging: Judging, ablated: Future, pool: Executor, turn: Turns) -> list[bool]:
    """Success in PhysX of policies that were trained on with the true effects, and kept by the same rule."""
    before, _ = ablated.result()
    what = _rehearsal(robot, judging, judging.out / robot.folder / "oracle", shares=False)
    told = rehearse(what, robot.patch, judging.how, pool, partial(turn, last=True))
    return [bool(success) for success in told["played"]["reality_after"]] if told["adopted"] else before
