"""The box before the wall: up the wall, and laid down on it.

Practice: moving the box on top, and bringing it up while the wall is lower, from nearly flat to nearly whole.
"""

from __future__ import annotations

from np_description.domains import WALL as DOMAIN
from np_training.tasks.config import TaskConfig
from np_training.tasks.kinds import OWN, Kind, lower, moves
from np_training.tasks.poses import sample_tasks

WALL = TaskConfig(
    DOMAIN,
    practice=0.75,
    explore=0.3,
    far=1000.0,
    kinds=(OWN, Kind("top", moves), *lower("low", sample_tasks)),
)
