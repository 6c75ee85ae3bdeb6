"""How large the effects of a withheld robot are: found by halving, in pairs of episodes in PhysX, until it loses as much as it shall."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor

import numpy as np

from np_blind.robot_cases import DOMAINS, LOSS, Robot, drawn
from np_bringup.rehearsal.playing import CHUNK, Cell, play, text_of
from np_effects.patch import Patch
from np_record.command import Progress

TASKS = 700  # seed of the tasks by which sizes are found: none that a robot is judged by
MIDDLE = (0.15, 0.33)  # of the loss, so that with as few episodes it is within LOSS
HALVINGS = 5
ATTEMPTS = 10


class Measured:
    """Success in PhysX, of `episodes` tasks, by domain and patch; what was played is not played again."""

    def __init__(self, pool: Executor, episodes: int):
        self._pool, self.episodes = pool, episodes
        self._nominal = {domain: self._ask(domain, Patch()) for domain in DOMAINS}

    def _ask(self, domain: str, patch: Patch):
        cell = Cell(domain, "physx", text_of(patch), seed=TASKS)
        numbers = range(self.episodes)
        return [self._pool.submit(play, cell, numbers[k : k + CHUNK]) for k in range(0, self.episodes, CHUNK)]

    def loss(self, domain: str, patch: Patch) -> float:
        """Of success, episode by episode."""
        asked = self._ask(domain, patch)
        nominal, own = ([s for part in parts for s in part.result()] for parts in (self._nominal[domain], asked))
        return float(np.mean(nominal) - np.mean(own))


def find_robot(number: int, seed: int, loss: Callable[[str, Patch], float], episodes: int) -> Robot:
    """The robot of a number: the first draw that loses enough at some size, with that size. Raises ValueError where none does."""
    for attempt in range(ATTEMPTS):
        domain, of_size = drawn(number, seed, attempt)
        size, low, high = 1.0, 0.0, 1.0
        for _ in range(HALVINGS + 1):
            found = loss(domain, of_size(size))
            if MIDDLE[0] <= found <= MIDDLE[1]:
                return Robot(number, domain, of_size(size).effects, round(found, 4), episodes)
            if found < MIDDLE[0]:
                if size == high:  # the largest that is tried
                    break
                low = size
            else:
                high = size
            size = (low + high) / 2
    raise ValueError(
        f"robot {number} of seed {seed}: no draw of {ATTEMPTS} loses {LOSS[0]:g} to {LOSS[1]:g} of success"
    )


def find_robots(count: int, seed: int, pool: Executor, episodes: int) -> list[Robot]:
    """The robots of a set, all of them searched for at once."""
    measured, progress = Measured(pool, episodes), Progress(count, "robots")
    progress.show(0)
    with ThreadPoolExecutor(count) as threads:
        asked = [threads.submit(find_robot, n, seed, measured.loss, episodes) for n in range(count)]
        found = []
        for future in asked:
            found.append(future.result())
            progress.show(len(found))
    return found
