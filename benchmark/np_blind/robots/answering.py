"""A withheld robot recorded, diagnosed, rehearsed and judged in PhysX. Each stage has a file, and is not done again where that is there."""

from __future__ import annotations

import json
import shutil
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Condition, Event

import numpy as np
from sim2real.effects.patch import Patch, dump_patch, load_patch

from np_blind.repository import relative
from np_blind.robots.cases import DOMAINS, Robot
from np_blind.robots.queue import DOCTOR, ENGINE, REHEARSAL, Queue, TimeOver
from np_common.cli import Progress
from np_common.files import write_atomically
from np_evaluation.corrections import corrections
from np_evaluation.finetune.learning import Learning, carried, warm
from np_evaluation.finetune.playing import Cell, Kept, patch_of, play_all, succeeds, text_of
from np_evaluation.finetune.stages import KEPT, Rehearsal, rehearse, trained

SUITES = 2  # recordings of the task suite, in which the object lies elsewhere
TASKS = 900  # seed of the tasks by which robots are judged
GRACE = 20.0  # s after the end of the time for episodes that are being played
ORACLES = ("all", "corrected", "none")  # of which robots the same is done with the true effects
TOLD = ("cause", "costs", "kept", "corrected", "not_trained", "success", "lost")  # of a rehearsal, that a row has


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


@dataclass(frozen=True)
class Judging:
    """How robots are judged. seed: of the set; episodes, share_episodes: of every figure, and of every subset of the effects found; how:
    training, None: all but that; oracle: one of ORACLES, `corrected` where it takes no training; out: folder; left: effects that are left to training,
    by id; oracle_first: what is trained with true effects, for which nobody has to be asked, is begun while doctors still are."""

    out: Path
    seed: int
    episodes: int
    share_episodes: int
    how: Learning | None
    oracle: str = "all"
    left: tuple[str, ...] = ()
    oracle_first: bool = False

    def asks_oracle(self, robot: Robot) -> bool:
        """Whether the same is done with a robot's true effects."""
        if self.oracle == "all" and self.how is not None:
            return True
        return self.oracle != "none" and not self.trains(robot.patch)

    def trains(self, patch: Patch) -> bool:
        """Whether there is anything in a patch that policies are trained for."""
        return bool(carried(corrections(patch, self.left).remaining)[0].effects)

    def is_done(self, robot: Robot, row: Mapping) -> bool:
        """Whether a row has all that is asked for: its weights may lie on another machine."""
        if row.get("episodes") != self.episodes or row.get("error") or "adopted" not in row["engine"]:
            return False
        is_trained = row["engine"]["after"] is not None or not self.trains(patch_of(row["found"]))
        return (is_trained or self.how is None) and ("oracle" in row["engine"] or not self.asks_oracle(robot))


def nominal_success(domains: Sequence[str], judging: Judging, pool: Executor) -> dict[str, list[float]]:
    """Scores of the released policies on the robot that is believed in, in both engines, as `wall_mujoco`."""
    cells = {f"{d}_{e}": Cell(d, e, seed=TASKS) for d in domains for e in ("mujoco", "physx")}
    return play_all(cells, judging.episodes, judging.out / "nominal", pool, "nominal")


def settle_all(robots: Sequence[Robot], judging: Judging, queue: Queue, turn: Turns) -> list[dict]:
    """A row for each robot, as far as the time of `queue` went; robots side by side."""
    progress, threads = Progress(len(robots), "robots"), ThreadPoolExecutor(len(robots) + len(DOMAINS) + 1)
    progress.show(0)
    try:
        domains = sorted({robot.domain for robot in robots})
        waits = not any(is_diagnosed(judging.out, robot) for robot in robots)  # for a diagnosis: nobody trains before
        if waits and judging.how is not None and judging.how.gpu is not None and not judging.oracle_first:
            for domain in domains:
                threads.submit(warm, domain, judging.out / "warm" / domain, judging.how, lambda: queue.is_over)
        nominal = threads.submit(nominal_success, domains, judging, queue.ranked(REHEARSAL))
        # Those that have to be trained for first: they are what takes longest.
        ordered = sorted(robots, key=lambda robot: not judging.trains(robot.patch))
        asked = [threads.submit(settle, robot, judging, nominal, queue, turn) for robot in ordered]
        for number, _ in enumerate(as_completed(asked, queue.left(GRACE)), 1):
            progress.show(number)
    except TimeoutError:  # of what is under way the rows have what was known before
        pass
    except BaseException:
        queue.end()
        raise
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
    return answered(robots, judging)


def answered(robots: Sequence[Robot], judging: Judging) -> list[dict]:
    """The rows that are there."""
    kept = (judging.out / robot.folder / "row.json" for robot in robots)
    return [json.loads(path.read_text(encoding="utf-8")) for path in kept if path.exists()]


def settle(robot: Robot, judging: Judging, nominal: Future, queue: Queue, turn: Turns) -> dict:
    """The row of a robot: what is known of it when the time is over, or all; what goes wrong is in it too. Kept after every stage."""
    file = judging.out / robot.folder / "row.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    if judging.is_done(robot, known):
        return known
    row = known if known.get("episodes") == judging.episodes else {}
    row |= {"robot": robot.number, "domain": robot.domain, "truth": dump_patch(robot.patch)}
    row |= {"episodes": judging.episodes, "error": "the time was over"}

    def keep() -> None:
        write_atomically(file, json.dumps(row, indent=1) + "\n")

    try:
        _settle(row, keep, robot, judging, nominal, queue, turn)
        del row["error"]
    except TimeOver:
        pass
    except Exception:
        if not queue.is_over:
            row["error"] = relative(traceback.format_exc(limit=3))
    keep()
    return row


def _settle(row: dict, keep: Callable[[], None], robot: Robot, judging: Judging, nominal, queue: Queue, turn) -> None:
    """What asks no doctor is done beside: PhysX without each true effect, and the oracle's training, which lets the others go first."""
    queue.check()
    begun = Event()  # from here on the oracle finds what both play
    with ThreadPoolExecutor(2) as beside:
        without = beside.submit(without_each, robot, judging, queue.ranked(ENGINE))
        oracle = beside.submit(_oracle, robot, judging, begun, queue, turn) if judging.asks_oracle(robot) else None
        try:
            patch, row["diagnosis"] = _diagnosed(robot, judging, queue.ranked(DOCTOR))
            row["found"] = dump_patch(patch)
            keep()
            believed = succeeds(nominal.result()[f"{robot.domain}_physx"])

            def tell(told: dict) -> None:
                row.update({name: told[name] for name in TOLD})
                row["engine"] = {**row.get("engine", {}), "nominal": believed, "before": told["played"]["reality"]}
                row["took_s"] = told["wall_s"]
                keep()
                begun.set()

            what = _rehearsal(robot, judging, judging.out / robot.folder, queue, tell)
            told = rehearse(what, patch, judging.how, queue.ranked(REHEARSAL), turn)
            row["engine"] |= _after(told)
            keep()
        finally:
            begun.set()
            if "engine" in row:  # also where training died
                row |= ablations(robot, judging, nominal.result()[f"{robot.domain}_physx"], without.result())
                keep()
        if oracle is not None:
            row["engine"]["oracle"] = oracle.result()


def is_diagnosed(out: Path, robot: Robot) -> bool:
    """Whether the doctor has answered for a robot."""
    return (out / robot.folder / "diagnosis.json").exists()


def _diagnosed(robot: Robot, judging: Judging, pool: Executor) -> tuple[Patch, dict]:
    from np_blind.robots.recording import diagnosis, recorded_arm, recorded_task  # slow to import

    folder = judging.out / robot.folder
    told, found = folder / "diagnosis.json", folder / "patch.yaml"
    if not is_diagnosed(judging.out, robot):
        begun = time.monotonic()
        seed = 1000 * judging.seed + 10 * robot.number
        asked = [pool.submit(recorded_arm, robot.patch, seed)]
        asked += [pool.submit(recorded_task, robot.patch, seed + number) for number in range(SUITES)]
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
        patch, said = pool.submit(diagnosis, log, [task for task in tasks if task is not None]).result()
        said |= {"not_recorded": refused, "took_s": round(time.monotonic() - begun, 1)}
        found.write_text(dump_patch(patch), encoding="utf-8")
        told.write_text(json.dumps(said, indent=1), encoding="utf-8")
    return load_patch(found), json.loads(told.read_text(encoding="utf-8"))


def reality_of(robot: Robot) -> Cell:
    return Cell(robot.domain, "physx", text_of(robot.patch), seed=TASKS)


def _rehearsal(robot: Robot, judging: Judging, folder: Path, queue: Queue, tell=None) -> Rehearsal:
    """In a folder, in which episodes lie that others have played already: what is believed in is the same for all robots. tell: None for the
    oracle, which blames nobody."""
    (folder / "episodes").mkdir(parents=True, exist_ok=True)
    known = {
        "nominal": judging.out / "nominal" / f"{robot.domain}_mujoco.json",
        "reality": judging.out / robot.folder / "episodes" / "reality.json",
    }
    for name, there in known.items():
        own = folder / "episodes" / f"{name}.json"
        if not own.exists() and there.exists():
            shutil.copyfile(there, own)
    return Rehearsal(
        Cell(robot.domain, seed=TASKS),
        folder,
        reality_of(robot),
        judging.episodes,
        judging.share_episodes if tell else 0,
        name=f"{robot.folder} " if tell else f"{robot.folder} oracle ",
        beside=True,
        tell=tell or (lambda told: None),
        go_on=queue.check,
        is_over=lambda: queue.is_over,
        left=judging.left,
    )


def without_each(robot: Robot, judging: Judging, pool: Executor) -> dict[str, list[float]]:
    """Scores of the old policies in PhysX without each of the true effects, where there are several."""
    effects, reality = robot.patch.effects, reality_of(robot)
    others = {e.effect: Patch(tuple(other for other in effects if other is not e)) for e in effects if len(effects) > 1}
    cells = {f"without_{name}": replace(reality, effects=text_of(patch)) for name, patch in others.items()}
    folder = judging.out / robot.folder / "episodes"
    played = play_all(cells, judging.episodes, folder, pool, f"{robot.folder} without" if cells else "")
    return {name: played[f"without_{name}"] for name in others}


def ablations(
    robot: Robot, judging: Judging, nominal: Sequence[float], without: Mapping[str, Sequence[float]]
) -> dict[str, dict[str, float]]:
    """What each true effect costs in PhysX, as `ablation` of success and `ablation_scores`: without it, less with all. Scores: nominal, and
    without each of several; those with all are kept."""
    kept = Kept(judging.out / robot.folder / "episodes", {"reality": reality_of(robot)})
    before = kept.of("reality", judging.episodes)
    others = without or {robot.effects[0].effect: nominal}
    return {
        "ablation": {n: float(np.mean(succeeds(each)) - np.mean(succeeds(before))) for n, each in others.items()},
        "ablation_scores": {n: float(np.mean(each) - np.mean(before)) for n, each in others.items()},
    }


def _after(told: dict) -> dict[str, list[int] | None]:
    """Success in PhysX with what a rehearsal has come to: corrected, after training, and of what it keeps, None where there is none."""
    played = told["played"]
    return {
        "corrected": played.get("reality_corrected"),
        "after": played.get("reality_after"),
        "adopted": played[KEPT[told["kept"]].replace("patched", "reality")],
    }


def _oracle(robot: Robot, judging: Judging, begun: Event, queue: Queue, turn: Turns) -> list[int]:
    """Success in PhysX of what the same comes to with the true effects."""
    last = partial(turn, last=True)
    what = partial(_rehearsal, robot, judging, judging.out / robot.folder / "oracle", queue)
    if judging.oracle_first and judging.how is not None and judging.trains(robot.patch):
        trained(what(), robot.patch, judging.how, last)
    begun.wait()
    told = rehearse(what(), robot.patch, judging.how, queue.ranked(ENGINE), last)
    return _after(told)["adopted"]
