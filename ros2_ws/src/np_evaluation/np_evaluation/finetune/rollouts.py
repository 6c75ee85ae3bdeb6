"""Scores of policies on robots, episode by episode: the same tasks for all of them, on many processes, kept as they come.

A score is 0 for a failure, and for a success .5 to 1: half of the room that was left is in it, in distance, angle or time, whichever was least.
Where every episode succeeds, the score still shows what comes near to failing.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from sim2real.effects.patch import Patch, PatchEffect, dump_patch

from np_common.cli import Progress
from np_common.files import write_atomically
from np_description.objects.choice import DEFAULT

if TYPE_CHECKING:  # slow to import
    from np_description.domains import Task
    from np_evaluation.scoring import Result

LEAST = 0.5  # score of a success that had no room left
LONGEST = 25.0  # s that an episode of one contact lasts, about, that runs out of time
CHUNK = 2  # episodes that a process plays at a time, 1 to 10 s: another robot costs it .01 s, and the last ones wait for few
"""Of processes of which each has a core."""


@dataclass(frozen=True)
class RolloutCell:
    """One policy on one robot."""

    domain: str
    """Task family."""
    engine: str = "mujoco"
    """mujoco or physx."""
    effects: str = ""
    """Text of a patch.yaml that the robot has; empty: nominal."""
    weights: str = ""
    """Folder; empty: the project's own."""
    object: str = DEFAULT
    """Row of the domain's table of objects, or the text of an object file."""
    seed: int = 0
    """Of the tasks and all that is random, with the episode's number."""
    contacts: int = 1
    """How often a contact may be chosen in an episode."""
    corrected: str = ""
    """Text of a patch that detector and driver are corrected for (`np_evaluation.calibration_corrections`)."""


def patch_of(text: str) -> Patch:
    """A patch from the text of its file, which `dump_patch` wrote."""
    entries = yaml.safe_load(text)["effects"] if text else []
    return Patch(tuple(PatchEffect(e["effect"], e["component"], e["parameters"]) for e in entries))


def text_of(patch: Patch) -> str:
    """The text of a patch, "" for the nominal robot."""
    return dump_patch(patch) if patch.effects else ""


def run_rollouts(cell: RolloutCell, numbers: Sequence[int]) -> list[float]:
    """Scores of these episodes, by the truth. A physics that diverges is a failure."""
    played = _rollout(cell)
    return [_score(played, number) for number in numbers]


def succeeds(scores: Sequence[float]) -> list[bool]:
    """Which scores are of a success."""
    return [score >= LEAST for score in scores]


def success_margin(domain: Task, result: Result) -> float:
    """Share 0..1 of distance, angle or time, whichever is least, that an episode that succeeded has left before it would have failed."""
    left = [1 - result.distance / domain.tolerance_position, 1 - result.duration / LONGEST]
    if domain.tolerance_angle is not None:
        left.append(1 - result.angle / domain.tolerance_angle)
    return max(min(left), 0.0)


@lru_cache(maxsize=1)
def _rollout(cell: RolloutCell):
    import torch  # slow, as what follows

    from np_description.objects.choice import domain_with
    from np_evaluation.in_process import InProcessRollout

    torch.set_num_threads(1)
    return InProcessRollout(
        domain_with(cell.domain, cell.object),
        cell.engine,
        seed=cell.seed,
        contacts=cell.contacts,
        patch=patch_of(cell.effects),
        corrected=patch_of(cell.corrected),
        weights=cell.weights,
    )


def _score(played, number: int) -> float:
    try:
        result = played.play(number)
    except FloatingPointError:
        return 0.0
    return round(LEAST + (1 - LEAST) * success_margin(played.domain, result), 4) if result.success else 0.0


class CachedScores:
    """Scores of named cells in a folder, a file each: what is there is not played again.

    Raises ValueError for a file that is of another cell.
    """

    def __init__(self, folder: Path, cells: Mapping[str, RolloutCell]):
        self._folder, self._cells = folder, dict(cells)
        folder.mkdir(parents=True, exist_ok=True)
        self._found = {name: self._read(name) for name in cells}

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.json"

    def _read(self, name: str) -> dict[int, float]:
        if not self._path(name).exists():
            return {}
        kept = json.loads(self._path(name).read_text(encoding="utf-8"))
        if kept["cell"] != asdict(self._cells[name]):
            raise ValueError(f"{self._path(name)}: expected scores of {self._cells[name]}, got those of {kept['cell']}")
        return {int(number): score for number, score in kept["score"].items()}

    def missing(self, name: str, episodes: int) -> list[int]:
        """Numbers below `episodes` that were not played."""
        return [number for number in range(episodes) if number not in self._found[name]]

    def add(self, name: str, numbers: Sequence[int], scores: Sequence[float]) -> None:
        """Keep what came of some episodes."""
        self._found[name] |= dict(zip(numbers, scores))
        scores = {str(n): s for n, s in sorted(self._found[name].items())}
        write_atomically(self._path(name), json.dumps({"cell": asdict(self._cells[name]), "score": scores}) + "\n")

    def of(self, name: str, episodes: int) -> list[float]:
        """Scores in the order of the episodes."""
        return [self._found[name][number] for number in range(episodes)]


def run_all_rollouts(
    cells: Mapping[str, RolloutCell], episodes: int, folder: Path, pool: Executor, what: str = "episodes"
) -> dict[str, list[float]]:
    """Scores of episodes 0 to `episodes` of each cell by its name, those of `folder` among them. what: of the progress shown, "" for none.
    Where one raises, the others are played and kept before that is raised."""
    kept = CachedScores(folder, cells)
    missing = {name: kept.missing(name, episodes) for name in cells}
    total = len(cells) * episodes
    progress, done = Progress(total, what), total - sum(map(len, missing.values()))
    show = progress.show if what else lambda done, text="": None
    show(done)
    asked, failed = {}, None
    for name, numbers in missing.items():
        for begin in range(0, len(numbers), CHUNK):
            chunk = numbers[begin : begin + CHUNK]
            asked[pool.submit(run_rollouts, cells[name], chunk)] = name, chunk
    for future in as_completed(asked):
        name, chunk = asked[future]
        try:
            kept.add(name, chunk, future.result())
        except Exception as error:
            failed = failed or error
            continue
        done += len(chunk)
        show(done, name)
    if failed is not None:
        raise failed
    return {name: kept.of(name, episodes) for name in cells}
