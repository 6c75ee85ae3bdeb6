"""How large the effects of a withheld robot are: looked for from where such effects begin to cost something, in pairs of episodes in PhysX, until
it loses as much as it shall."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from hashlib import sha256
from pathlib import Path

import numpy as np
from sim2real.effects.patch import Patch

from np_blind.robots.cases import DOMAINS, LOSS, MOST, Robot, draw_robot
from np_common.cli import Progress
from np_evaluation.finetune.rollouts import RolloutCell, run_all_rollouts, succeeds, text_of

TASKS = 700  # seed of the tasks by which sizes are found: none that a robot is judged by
MIDDLE = (0.15, 0.33)  # of the loss, so that with as few episodes it is within LOSS
FIRST, FACTOR = (
    1 / MOST,
    1.4,
)  # size that is tried first, an edge; by which it goes on while all were too small, or too large
TRIED, STRICT = (
    7,
    3,
)  # sizes at most of a draw; of these so many have to lose what is in MIDDLE, later ones what is within LOSS
CLOSE = 1.02  # ratio of a size that loses too much and one that loses too little, from which nothing is between them
ATTEMPTS = 10
LOOKS = ((8, 0.0, 0.6), (16, 0.05, 0.48))
"""(pairs, least and largest loss between which more pairs are played): what lies outside is not in MIDDLE by its standard error or two."""


class Measured:
    """Success in PhysX, of `episodes` tasks, by domain and patch; what was played is kept in `folder`, and not played again."""

    def __init__(self, pool: Executor, episodes: int, folder: Path):
        self._pool, self._folder, self.episodes = pool, folder, episodes
        self._nominal = self._success(
            {domain: RolloutCell(domain, "physx", seed=TASKS) for domain in DOMAINS}, episodes
        )

    def _success(self, cells: dict[str, RolloutCell], episodes: int) -> dict[str, list[bool]]:
        played = run_all_rollouts(cells, episodes, self._folder, self._pool, "")
        return {name: succeeds(scores) for name, scores in played.items()}

    def loss(self, domain: str, patch: Patch) -> float:
        """Of success, over pairs of episodes: all of them, or fewer where these already show that it is too little or too much."""
        text = text_of(patch)
        cell = {f"{domain}_{sha256(text.encode()).hexdigest()[:16]}": RolloutCell(domain, "physx", text, seed=TASKS)}
        for pairs, least, most in (*LOOKS, (self.episodes, 0.0, 1.0)):
            pairs = min(pairs, self.episodes)
            (own,) = self._success(cell, pairs).values()
            found = float(np.mean(self._nominal[domain][:pairs]) - np.mean(own))
            if pairs == self.episodes or not least < found < most:
                break
        return found


def find_robot(number: int, seed: int, loss: Callable[[str, Patch], float], episodes: int) -> Robot:
    """The robot of a number: the first draw that loses enough at some size, with that size. Raises ValueError where none does."""
    for attempt in range(ATTEMPTS):
        domain, of_size = draw_robot(number, seed, attempt)
        size, low, high = FIRST, None, None
        for tried in range(TRIED):
            found = loss(domain, of_size(size))
            least, most = MIDDLE if tried < STRICT else LOSS
            if least <= found <= most:
                return Robot(number, domain, of_size(size).effects, round(found, 4), episodes)
            if found > most:
                high = size
            elif size == 1.0:  # the largest that is tried
                break
            else:
                low = size
            if low and high and high / low < CLOSE:
                break
            size = min(size * FACTOR, 1.0) if high is None else high / FACTOR if low is None else (low * high) ** 0.5
    raise ValueError(
        f"robot {number} of seed {seed}: no draw of {ATTEMPTS} loses {LOSS[0]:g} to {LOSS[1]:g} of success"
    )


def find_robots(count: int, seed: int, pool: Executor, episodes: int, folder: Path) -> tuple[list[Robot], list[str]]:
    """The robots of a set, all of them searched for at once; and why others were not found. folder: of what is played."""
    measured, progress = Measured(pool, episodes, folder), Progress(count, "robots")
    progress.show(0)
    threads = ThreadPoolExecutor(count)
    try:
        asked = [threads.submit(find_robot, n, seed, measured.loss, episodes) for n in range(count)]
        for number, _ in enumerate(as_completed(asked), 1):
            progress.show(number)
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
    errors = [future.exception() for future in asked]
    found = [future.result() for future, error in zip(asked, errors) if error is None]
    return found, [str(error) for error in errors if error is not None]
