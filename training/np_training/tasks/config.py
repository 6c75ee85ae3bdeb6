"""What differs from task to task in training: one configuration each, in a file of its own."""

from __future__ import annotations

from dataclasses import dataclass

from np_description.domains import Task
from np_training.tasks.kinds import OWN, Kind


@dataclass(frozen=True)
class TaskConfig:
    """A domain as it is trained.

    limit: policy steps an episode; practice: share of practice at the beginning; explore: share of contacts chosen at random
    at the beginning; far: weight of the distance's own potential, for 1 m; kinds: of task, the domain's own first, then its
    practice.
    """

    domain: Task
    limit: int = 100
    practice: float = 0.0
    explore: float = 0.0
    far: float = 0.0
    kinds: tuple[Kind, ...] = (OWN,)
