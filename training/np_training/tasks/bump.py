"""The cube before the bump: over it, or onto it, with any face up.

Practice, in grades of yaw: rolling the cube once to the place next to where it lies; sliding it where there is hardly a bump;
sliding it across one that is lower than it is. Then one quarter turn about any axis, without the bump and with it. And what is left to do where
a push ended otherwise than it should: a turn about the vertical at the goal, and the goal from another one's place.
"""

from __future__ import annotations

from functools import partial
from math import pi

from np_description.domains import BUMP as DOMAIN
from np_training.tasks.config import TaskConfig
from np_training.tasks.kinds import OWN, Kind, corrects, moves, rolls, slides, turns

YAWS = (0.35, pi / 2, pi)  # rad: grades of how far a cube is turned about the vertical at most
FLAT = (0.75, 1.0)  # share of the obstacles' height that is sunk where they are hardly felt


def _graded(grade: int, yaw: float) -> tuple[Kind, ...]:
    return (
        Kind(f"roll{grade}", partial(rolls, yaw=yaw)),
        Kind(f"slide{grade}", partial(slides, yaw=yaw), FLAT),
        Kind(f"cross{grade}", partial(slides, yaw=yaw, from_start=True), (0.0, FLAT[0])),
    )


BUMP = TaskConfig(
    DOMAIN,
    limit=200,
    practice=0.75,
    explore=0.3,
    far=500.0,
    kinds=(
        OWN,
        *(kind for grade, yaw in enumerate(YAWS, 1) for kind in _graded(grade, yaw)),
        Kind("turn1", turns, FLAT),
        Kind("turn2", turns),
        Kind("correct", corrects, apart=False),
        Kind("again", moves),
    ),
)
