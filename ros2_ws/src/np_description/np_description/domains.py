"""The three tasks: object, fixed surroundings, start and goal distributions, success.

Densities and tolerances are the paper's (Kim et al., IROS 2023). It prints no sizes, which follow here from mass and density. It
describes the start and goal distributions only in words: the ranges in metres below are this project's reading of them. They are
in the base frame of the robot (x forward, y left, z up, table top at z = 0).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi

import numpy as np

from np_common.rotations import (
    matrix_from_quaternion,
    matrix_from_vector,
    quaternion_from_matrix,
    quaternion_multiply,
    rotation_angle,
    yaw_quaternion,
)
from np_description.contact.model import HARD, ContactModel
from np_description.objects.spec import ObjectSpec


@dataclass(frozen=True)
class Pose:
    """A pose in the base frame."""

    position: np.ndarray
    """(3,) m."""
    quaternion: np.ndarray
    """wxyz (4,)."""


@dataclass(frozen=True)
class Box:
    """A fixed box of the surroundings, axes along the base frame."""

    name: str
    """Of its body in the scene."""
    centre: tuple[float, float, float]
    """(3,) m."""
    half_size: tuple[float, float, float]
    """(3,) m."""


@dataclass(frozen=True)
class Region:
    """Uniform distribution of object poses resting on a horizontal surface."""

    x: tuple[float, float]
    """Range, m."""
    y: tuple[float, float]
    """Range, m."""
    surface: float = 0.0
    """Height, m."""
    yaw: tuple[float, float] = (-pi, pi)
    """Range, rad."""
    pitch: float = 0.0
    """Rotation about the y axis of the yawed object, a multiple of a quarter turn: the face it rests on, rad."""
    quarter_turns: bool = False
    """Whether roll and pitch are drawn from the four quarter turns instead."""


@dataclass(frozen=True)
class Task:
    """One task family: object, fixed surroundings, distributions of start and goal, success."""

    name: str
    """Its name in commands and parameters (`domain`)."""
    half_size: tuple[float, float, float]
    """Of the object, (3,) m."""
    density: float
    """Of the object, kg/m^3."""
    start: Region
    """Where the object begins."""
    goals: tuple[Region, ...]
    """Where it is to end; each is drawn with equal odds."""
    obstacles: tuple[Box, ...] = ()
    """Fixed boxes on the table."""
    goal_yaw: tuple[float, float] | None = None
    """Range of the goal's yaw relative to the start's, rad; None where the goal's own region draws it."""
    tolerance_position: float = 0.01
    """Of success, m."""
    tolerance_angle: float | None = 0.1
    """Of success, rad; None for position only."""
    workspace_x: tuple[float, float] = (0.30, 0.75)
    """Range outside of which the object counts as lost, m."""
    workspace_y: tuple[float, float] = (-0.35, 0.35)
    """Range outside of which the object counts as lost, m."""
    min_distance: float = 0.03
    """Tasks whose start and goal are nearer than this are drawn again, m."""
    max_opening: float = 0.005
    """Of one finger, m. Beyond it the object could be gripped, or jammed between the fingers: the task is to be done without."""
    tolerance_fraction: float = 0.8
    """Of the tolerance, that policies are trained to reach and the estimated pose has to reach: the rest is left to the estimate's error."""
    interchangeable: bool = False
    """Whether policies see the object under other names of its faces (np_description.symmetry)."""
    contact: ContactModel = HARD
    """In which its released weights were trained: what its scene is made of, and its bags judged by, unless another is given."""
    object: ObjectSpec | None = None
    """Another than its own, whose size and mean density the task then has (np_description.objects.choice); None: a homogeneous box."""

    @property
    def as_rigid_box(self) -> Task:
        """The task with a hard, homogeneous box of the object's size and mass, for drawing and planning, which move no parts."""
        return replace(self, object=None)

    @property
    def is_tumbled(self) -> bool:
        """Whether the goal may have the object on another face than the start; what is not lies on one face all the time."""
        regions = (self.start, *self.goals)
        return any(r.quarter_turns for r in regions) or len({r.pitch for r in regions}) > 1

    @property
    def mass(self) -> float:
        """Object mass in kg."""
        return self.density * 8 * float(np.prod(self.half_size))


CARD = Task(
    name="card",
    half_size=(0.025, 0.035, 0.0025),
    density=457.1,
    start=Region(x=(0.42, 0.58), y=(-0.13, 0.13)),
    goals=(Region(x=(0.42, 0.58), y=(-0.13, 0.13)),),
    goal_yaw=(-pi, pi),
    workspace_x=(0.34, 0.66),
    workspace_y=(-0.21, 0.21),
)

BUMP = Task(
    name="bump",
    half_size=(0.045, 0.045, 0.045),
    density=200.0,
    obstacles=(Box("bump", (0.50, 0.0, 0.015), (0.15, 0.06, 0.015)),),
    start=Region(x=(0.42, 0.58), y=(-0.17, -0.125), quarter_turns=True),
    goals=(
        Region(x=(0.42, 0.58), y=(-0.015, 0.015), surface=0.03, quarter_turns=True),
        Region(x=(0.42, 0.58), y=(0.125, 0.17), quarter_turns=True),
    ),
    interchangeable=True,
)

# The goal is a box that lies on the wall. Of one that stands there only the position would count, and a lying box that is
# tipped up has it too.
WALL = Task(
    name="wall",
    half_size=(0.025, 0.025, 0.05),
    density=150.0,
    obstacles=(Box("wall", (0.64, 0.0, 0.05), (0.08, 0.20, 0.05)),),
    start=Region(x=(0.53, 0.53), y=(-0.15, 0.15), yaw=(0.0, 0.0)),
    goals=(Region(x=(0.60, 0.64), y=(0.05, 0.15), surface=0.10, yaw=(0.0, 0.0), pitch=pi / 2),),
    tolerance_angle=None,
    tolerance_fraction=0.6,
)

GOAL_SLACK = {"x": 0.002, "y": 0.002, "surface": 0.015}
"""By how many m a goal may be beside its region: an object measured anew, a table that is not quite level."""

DOMAINS = {domain.name: domain for domain in (CARD, BUMP, WALL)}


def find_domain(name: str) -> Task:
    """The domain called `name`. Raises ValueError with the known names."""
    if name not in DOMAINS:
        raise ValueError(f"domain: expected one of {', '.join(DOMAINS)}, got {name!r}")
    return DOMAINS[name]


def sample_pose(domain: Task, region: Region, rng: np.random.Generator) -> Pose:
    """A pose of the domain's object at rest in `region`."""
    yaw = rng.uniform(*region.yaw)
    roll, pitch = rng.integers(0, 4, size=2) * (pi / 2) if region.quarter_turns else (0.0, region.pitch)
    return resting_pose(domain, region, rng.uniform(*region.x), rng.uniform(*region.y), yaw, roll, pitch)


def resting_pose(domain: Task, region: Region, x: float, y: float, yaw: float, roll: float, pitch: float) -> Pose:
    """The object at x, y m on the surface of `region`, turned by roll, then pitch, then yaw, rad; face-down."""
    quaternion = yaw_quaternion(np.asarray(yaw))
    if roll or pitch:
        turn = matrix_from_vector(np.array([0.0, pitch, 0.0])) @ matrix_from_vector(np.array([roll, 0.0, 0.0]))
        quaternion = quaternion_multiply(quaternion, quaternion_from_matrix(turn))
    return Pose(np.array([x, y, region.surface + resting_height(domain, quaternion)]), quaternion)


def resting_height(domain: Task, quaternion: np.ndarray) -> float:
    """Height m of the object's centre over the surface on which it rests, for face-down orientations."""
    return float(np.abs(matrix_from_quaternion(quaternion)[2]) @ np.asarray(domain.half_size))


def sample_task(domain: Task, rng: np.random.Generator) -> tuple[Pose, Pose]:
    """Start and goal pose of one episode, at least `domain.min_distance` apart."""
    while True:
        start = sample_pose(domain, domain.start, rng)
        goal = sample_pose(domain, domain.goals[rng.integers(len(domain.goals))], rng)
        if domain.goal_yaw is not None:
            turn = yaw_quaternion(np.asarray(rng.uniform(*domain.goal_yaw)))
            goal = Pose(goal.position, quaternion_multiply(turn, start.quaternion))
        if np.linalg.norm(goal.position - start.position) >= domain.min_distance:
            return start, goal


def goal_region(domain: Task, goal: Mapping[str, float], margin: Mapping[str, float]) -> Region:
    """The domain's goal region that holds a goal, within a margin. Both have, by name, what counts of x, y, surface m and yaw rad.

    Raises ValueError with the domain's goals where none does.
    """
    for region in domain.goals:
        limits = {"x": region.x, "y": region.y, "surface": (region.surface, region.surface), "yaw": region.yaw}
        if all(limits[n][0] - margin[n] <= value <= limits[n][1] + margin[n] for n, value in goal.items()):
            return region
    goals = "; ".join(
        f"x {r.x}, y {r.y}, surface {r.surface} m, yaw {np.round(r.yaw, 2).tolist()} rad" for r in domain.goals
    )
    got = ", ".join(f"{name} {value:.3f}" for name, value in goal.items())
    raise ValueError(f"goal: expected one of {domain.name}'s goals ({goals}), got {got}")


def check_goal(domain: Task, pose: Pose) -> None:
    """Raises ValueError for a goal that rests in none of the domain's goal regions, within `GOAL_SLACK`: mostly another domain's."""
    x, y, z = pose.position
    goal_region(domain, {"x": x, "y": y, "surface": z - resting_height(domain, pose.quaternion)}, GOAL_SLACK)


def pose_error(position_a, quaternion_a, position_b, quaternion_b):
    """Distance (...) m and angle (...) rad between poses; NumPy or PyTorch."""
    difference = position_a - position_b
    return (difference * difference).sum(axis=-1) ** 0.5, rotation_angle(quaternion_a, quaternion_b)


def is_success(domain: Task, distance, angle, share: float = 1.0):
    """Whether errors (...) from `pose_error` are within the domain's tolerance, or a share of it."""
    near = distance <= share * domain.tolerance_position
    return near if domain.tolerance_angle is None else near & (angle <= share * domain.tolerance_angle)


def is_lost(domain: Task, position):
    """Whether object positions (..., 3) m have left the workspace, or fallen below the table."""
    x, y, z = position[..., 0], position[..., 1], position[..., 2]
    return (
        (x < domain.workspace_x[0])
        | (x > domain.workspace_x[1])
        | (y < domain.workspace_y[0])
        | (y > domain.workspace_y[1])
        | (z < -0.02)
    )
