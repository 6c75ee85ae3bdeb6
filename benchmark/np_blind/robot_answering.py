"""A withheld robot recorded, diagnosed, rehearsed and judged in PhysX. Each stage has a file, and is not done again where that is there."""

from __future__ import annotations

import json
import shutil
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from np_blind.robot_cases import Robot
from np_bringup.rehearsal.learning import Learning, carried, learn
from np_bringup.rehearsal.playing import Cell, patch_of, play_all, text_of
from np_bringup.rehearsal.stages import Rehearsal, Turn, rehearse
from np_effects.patch import Patch, dump_patch, load_patch
from np_record.command import Progress

SUITES = 2  # recordings of the task suite, in which the object lies elsewhere
TASKS = 900  # seed of the tasks by which robots are judged


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


def settle_all(robots: Sequence[Robot], judging: Judging, pool: Executor, turn: Turn) -> list[dict]:
    """A row for each robot, as far as the time went; robots side by side."""
    nominal = nominal_success(sorted({robot.domain for robot in robots}), judging, pool)
    progress, rows = Progress(len(robots), "robots"), []
    progress.show(0)
    with ThreadPoolExecutor(len(robots)) as threads:
        for future in [threads.submit(settle, robot, judging, nominal, pool, turn) for robot in robots]:
            rows.append(future.result())
            progress.show(len(rows))
    return rows


def settle(robot: Robot, judging: Judging, nominal: dict[str, list[bool]], pool: Executor, turn: Turn) -> dict:
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


def _settle(row: dict, robot: Robot, judging: Judging, nominal, pool: Executor, turn: Turn) -> None:
    folder = judging.out / robot.folder
    reality = Cell(robot.domain, "physx", text_of(robot.patch), seed=TASKS)
    believed = nominal[f"{robot.domain}_physx"]
    judging.check()
    patch, row["diagnosis"] = _diagnosed(robot, judging, pool)
    row["found"] = dump_patch(patch)
    judging.check()
    _share_nominal(robot, judging, folder)
    what = Rehearsal(
        Cell(robot.domain, seed=TASKS),
        folder,
        reality,
        judging.episodes,
        judging.share_episodes,
        name=f"{robot.folder} ",
        go_on=judging.check,
    )
    told = rehearse(what, patch, judging.how, pool, turn)
    played = {"before": told["played"]["reality"], "after": told["played"].get("reality_after")}
    adopted = played["after"] if told["adopted"] else played["before"]
    row |= {name: told[name] for name in ("cause", "costs", "adopted", "not_trained", "success", "lost")}
    row |= {"engine": {"nominal": believed, **played, "adopted": adopted}, "took_s": told["wall_s"]}
    judging.check()
    row["ablation"] = _ablation(robot, judging, reality, played["before"], believed, pool)
    if judging.oracle:
        judging.check()
        row["engine"]["oracle"] = _oracle(robot, judging, reality, pool, turn)


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


def _share_nominal(robot: Robot, judging: Judging, folder: Path) -> None:
    """The nominal robot in the simulator is everybody's: it is played once."""
    (folder / "episodes").mkdir(parents=True, exist_ok=True)
    own = folder / "episodes" / "nominal.json"
    if not own.exists():
        shutil.copyfile(judging.out / "nominal" / f"{robot.domain}_mujoco.json", own)


def _ablation(robot: Robot, judging: Judging, reality: Cell, before, believed, pool: Executor) -> dict[str, float]:
    """What each true effect costs in PhysX: success without it, less success with all."""
    effects = robot.patch.effects
    others = {e.effect: Patch(tuple(other for other in effects if other is not e)) for e in effects if len(effects) > 1}
    cells = {f"without_{name}": replace(reality, effects=text_of(patch)) for name, patch in others.items()}
    folder = judging.out / robot.folder / "episodes"
    played = play_all(cells, judging.episodes, folder, pool, f"{robot.folder} ablation") if cells else {}
    without = {name: played[f"without_{name}"] for name in others} or {effects[0].effect: believed}
    return {name: (sum(each) - sum(before)) / len(before) for name, each in without.items()}


def _oracle(robot: Robot, judging: Judging, reality: Cell, pool: Executor, turn: Turn) -> list[bool] | None:
    """Success in PhysX of policies trained on with the true effects."""
    patch, _ = carried(patch_of(text_of(robot.patch)))
    if not patch.effects:
        return None
    with turn() as gpu:
        judging.check()
        learned = learn(robot.domain, patch, judging.out / robot.folder / "oracle", replace(judging.how, gpu=gpu))
    cells = {"reality_oracle": replace(reality, weights=learned["weights"])}
    folder = judging.out / robot.folder / "episodes"
    return play_all(cells, judging.episodes, folder, pool, f"{robot.folder} oracle")["reality_oracle"]
