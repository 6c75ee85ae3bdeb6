"""What differs from task to task in training: one configuration each, in a file of its own."""

from __future__ import annotations

from dataclasses import dataclass

from np_description.domains import Task
from np_training.tasks.kinds import OWN, Kind


@dataclass(frozen=True)
class TaskConfig:
    """A task as it is trained."""

    domain: Task
    """Object, surroundings, start, goal and success."""
    limit: int = 100
    """Policy steps an episode."""
    practice: float = 0.0
    """Share of practice at the beginning."""
    explore: float = 0.0
    """Share of contacts chosen at random at the beginning."""
    far: float = 0.0
    """Weight of the distance's own potential, for 1 m."""
    kinds: tuple[Kind, ...] = (OWN,)
    """Of task, the own first, then its practice."""
