"""Recordings of evaluated episodes, because the machine that trains may not be able to draw."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from np_training.episodes.episodes import MODES, Episodes

PERIOD = 0.1  # s between positions: the policy's


@dataclass(frozen=True)
class RecordedEpisodes:
    """domain: name; mode (n,): names of how the episodes ended; length (n,) policy steps; goals (n, 7):
    position m, quaternion wxyz; qpos (steps + 1, n, 16); tips (n,): quarter turns that the task needs, 0
    where the domain has none."""

    domain: str
    mode: np.ndarray
    length: np.ndarray
    goals: np.ndarray
    qpos: np.ndarray
    tips: np.ndarray

    def choose(self, count: int) -> np.ndarray:
        """Rows of `count` played episodes, half of them failures where there are as many, in order."""
        played = self.mode != "infeasible"
        won, failed = (np.flatnonzero(played & mask) for mask in (self.mode == "success", self.mode != "success"))
        failures = min(len(failed), max(count // 2, count - len(won)))
        return np.sort(np.concatenate([won[: count - failures], failed[:failures]]))


def save_recording(path: Path, domain: str, episodes: Episodes) -> None:
    """Write episodes that were run with `record`."""
    tips = sum(
        (k * episodes.groups[f"tips{k}"] for k in (1, 2) if f"tips{k}" in episodes.groups),
        np.zeros(len(episodes), int),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            domain=domain,
            mode=np.array(MODES)[episodes.mode],
            length=episodes.length,
            goals=episodes.goals,
            qpos=episodes.qpos,
            tips=tips,
        )


def load_recording(path: Path) -> RecordedEpisodes:
    """Read what `save_recording` wrote. Raises ValueError where something is missing."""
    with np.load(path) as file:
        missing = set(RecordedEpisodes.__dataclass_fields__) - set(file.files)
        if missing:
            raise ValueError(
                f"recording {path}: expected the arrays of np_training.evaluate --record, "
                f"without {', '.join(sorted(missing))}"
            )
        return RecordedEpisodes(**{name: file[name] if file[name].ndim else str(file[name]) for name in file.files})
