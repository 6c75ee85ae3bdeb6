"""The tasks that can be trained, by the names of their domains."""

from __future__ import annotations

from np_training.tasks.bump import BUMP
from np_training.tasks.card import CARD
from np_training.tasks.config import TaskConfig
from np_training.tasks.wall import WALL

TASKS = {task.domain.name: task for task in (CARD, BUMP, WALL)}


def find_task(name: str) -> TaskConfig:
    """The task of the domain called `name`. Raises ValueError with the known names."""
    if name not in TASKS:
        raise ValueError(f"task: expected one of {', '.join(TASKS)}, got {name!r}")
    return TASKS[name]
