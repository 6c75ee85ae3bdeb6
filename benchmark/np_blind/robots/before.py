"""What withheld robots lose in PhysX, and by which effect: known before any doctor is asked, kept where the rehearsals look for it."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor

import numpy as np

from np_blind.robots.answering import Judging, ablations, nominal_success, reality_of, without_each
from np_blind.robots.cases import Robot
from np_blind.robots.queue import ENGINE, REHEARSAL, Queue, TimeOver
from np_evaluation.finetune.playing import play_all, succeeds
from np_evaluation.finetune.shares import mean_and_interval


def play_before(robots: Sequence[Robot], judging: Judging, queue: Queue) -> list[dict]:
    """A row for each robot that was played to its end in the time of `queue`: `loss` of success in pairs of episodes, and `ablation`."""
    domains = sorted({robot.domain for robot in robots})
    rows = []
    with ThreadPoolExecutor(2 * len(robots) + 1) as threads:
        nominal = threads.submit(nominal_success, domains, judging, queue.ranked(REHEARSAL))
        before = [threads.submit(_before, robot, judging, queue.ranked(REHEARSAL)) for robot in robots]
        without = [threads.submit(without_each, robot, judging, queue.ranked(ENGINE)) for robot in robots]
        for robot, *asked in zip(robots, before, without):
            try:
                believed, own, others = (future.result() for future in (nominal, *asked))
            except TimeOver:  # what was played is kept
                continue
            scores = believed[f"{robot.domain}_physx"]
            loss = mean_and_interval(np.subtract(succeeds(scores), succeeds(own), dtype=float))
            rows.append({"robot": robot.number, "loss": loss, **ablations(robot, judging, scores, others)})
    return rows


def _before(robot: Robot, judging: Judging, pool: Executor) -> list[float]:
    folder = judging.out / robot.folder / "episodes"
    return play_all({"reality": reality_of(robot)}, judging.episodes, folder, pool, f"{robot.folder} before")["reality"]
