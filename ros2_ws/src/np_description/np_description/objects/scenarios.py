"""Three fixed tasks in each domain: a start and a goal, and a little scatter of the start, as a hand sets an object down.

The paper tries each object in three scenarios with other start and goal poses, which it shows and does not print: these are
this project's. Places are shares of the domain's regions, so that they hold for an object of any size.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from np_description.domains import Pose, Region, Task, resting_pose

SCATTER = 0.002, 0.03  # m, rad, either way, where the region leaves that much


@dataclass(frozen=True)
class ScenarioPlace:
    """A place in a region of a domain."""

    x: float
    """Share of the region's range, 0 to 1."""
    y: float
    """Share of the region's range, 0 to 1."""
    yaw: float = 0.0
    """rad."""
    roll: int = 0
    """Quarter turns before the yaw."""
    pitch: int = 0
    """Quarter turns before the yaw."""
    goal: int | None = 0
    """Number of the goal region; None: the start region."""


@dataclass(frozen=True)
class Scenario:
    """A fixed task."""

    start: ScenarioPlace
    """The object's place."""
    goal: ScenarioPlace
    """The goal's place."""


def _from(*values, **turns) -> ScenarioPlace:
    return ScenarioPlace(*values, **turns, goal=None)


SCENARIOS = {
    "card": (
        Scenario(_from(0.2, 0.2, 0.0), ScenarioPlace(0.7, 0.7, 0.6)),  # away and to the left, turned a little
        Scenario(_from(0.8, 0.8, 1.2), ScenarioPlace(0.3, 0.3, 0.0)),  # near and to the right, turned back
        Scenario(_from(0.5, 0.1, -0.8), ScenarioPlace(0.5, 0.9, 0.6)),  # across, turned by 80 degrees
    ),
    "bump": (
        Scenario(_from(0.5, 0.5), ScenarioPlace(0.5, 0.5, roll=3)),  # onto the bump, tipped over its edge
        Scenario(_from(0.2, 0.5, 0.3), ScenarioPlace(0.6, 0.5, 0.0, goal=1)),  # beyond it, on the same face
        Scenario(_from(0.8, 0.5, -0.3, pitch=1), ScenarioPlace(0.2, 0.5, 0.0, roll=2)),  # onto it, on the opposite face
    ),
    "wall": (
        Scenario(_from(0.5, 0.5), ScenarioPlace(0.5, 0.5)),  # up, and to the left
        Scenario(_from(0.5, 0.9), ScenarioPlace(0.2, 0.2)),  # up, near the edge
        Scenario(_from(0.5, 0.1), ScenarioPlace(0.8, 0.8)),  # up, far, and across
    ),
}
"""By domain, in order; left, right, away: as seen from the robot."""
COUNT = 3


def make_fixed_task(domain: Task, number: int, rng: np.random.Generator | None = None) -> tuple[Pose, Pose]:
    """Start and goal of scenario 1, 2 or 3; rng: of the scatter, None for none. Raises ValueError for another number."""
    if not 1 <= number <= COUNT:
        raise ValueError(f"scenario: expected 1 to {COUNT}, got {number}")
    scenario = SCENARIOS[domain.name][number - 1]
    return _pose(domain, scenario.start, rng), _pose(domain, scenario.goal, None)


def _pose(domain: Task, place: ScenarioPlace, rng: np.random.Generator | None) -> Pose:
    region = domain.start if place.goal is None else domain.goals[place.goal]
    x, y = (low + share * (high - low) for (low, high), share in ((region.x, place.x), (region.y, place.y)))
    yaw = place.yaw
    if rng is not None:
        x, y, yaw = _scatter(region, np.array([x, y, yaw]), rng)
    pitch = place.pitch * pi / 2 if region.quarter_turns else region.pitch
    return resting_pose(domain, region, x, y, yaw, place.roll * pi / 2, pitch)


def _scatter(region: Region, where: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    low, high = np.transpose([region.x, region.y, region.yaw])
    scatter = np.array([SCATTER[0], SCATTER[0], SCATTER[1]])
    return np.clip(where + rng.uniform(-scatter, scatter), low, high)
