"""Boxes that rest on a table, seen by a camera that is not at its nominal pose: for the view stage, and with none of its code.

Projection by a 3 x 4 matrix from a camera that looks at the table; poses by SciPy's rotations; a detector with an error of its own for each
corner and view, part of it shared by all corners of a view, heavier where a corner is hidden below, now and then gross.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation
from sim2real.task.camera.rest_poses import RestPose

from np_blind.camera.simulated_camera import SIGNS
from np_description.domains import CARD, Task

MIDDLE = np.array([0.5, 0.0])  # m, about which a table tilts
OPTICAL_X, FORWARD = (
    np.array([0.0, 1.0, 0.0]),
    np.array([0.5 - 1.1, 0.0, -0.68]),
)  # of the nominal camera
ATTEMPTS = 200
DEGREE = np.pi / 180


@dataclass(frozen=True)
class Truth:
    """The true set-up less the nominal one: m, rad, px, 1."""

    camera: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    focal: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)
    k1: float = 0.0
    height: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    size: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __add__(self, other: Truth) -> Truth:
        sums = {name: np.add(value, getattr(other, name)) for name, value in vars(self).items()}
        return Truth(**{name: float(v) if v.ndim == 0 else tuple(v.tolist()) for name, v in sums.items()})

    @property
    def numbers(self) -> np.ndarray:
        """(16,): camera x y z, turn x y z, focal length, offset u v, k1, height, tilt x y, size x y z."""
        return np.concatenate([np.atleast_1d(np.asarray(value, float)) for value in vars(self).values()])


@dataclass(frozen=True)
class Detector:
    """Errors in px: own, of a corner in a view; shared, of all corners of a view; gross: share of corners, and how far those are off.
    scatter: standard error of a corner by scatter from image to image; measured: m and rad of a pose, None where nothing measures it."""

    own: float = 0.4
    shared: float = 0.15
    gross: tuple[float, float] = (0.03, 12.0)
    scatter: float = 0.05
    measured: tuple[float, float] | None = (0.0005, 0.15 * DEGREE)


@dataclass(frozen=True)
class CameraCase:
    """A set-up with what is true of it, how often the object is put down, and what the picture is cut off by."""

    truth: Truth = field(default_factory=Truth)
    detector: Detector = field(default_factory=Detector)
    domain: Task = CARD
    count: int = 8
    moved: tuple[int, Truth] | None = None  # from which place on something else is true as well
    dent: float = 0.0  # m by which one corner of the object is pushed in


def usual(rng: np.random.Generator) -> Truth:
    """What is off in every set-up, drawn evenly within bounds: 1 mm and .1 degree of the camera, 1 mm of size, and little of all else."""

    def within(bound: float, count: int) -> tuple[float, ...]:
        return tuple(rng.uniform(-bound, bound, count).tolist())

    return Truth(
        within(0.001, 3),
        within(0.1 * DEGREE, 3),
        *within(0.001, 1),
        within(0.3, 2),
        *within(0.01, 1),
        *within(0.0005, 1),
        within(0.05 * DEGREE, 2),
        within(0.001, 3),
    )


def pixels(truth: Truth, corners: np.ndarray) -> np.ndarray:
    """Where the true camera has corners (n, 3) m of the base frame, px (n, 2)."""
    forward = FORWARD / np.linalg.norm(FORWARD)
    axes = np.column_stack([OPTICAL_X, np.cross(forward, OPTICAL_X), forward])
    turned = (Rotation.from_rotvec(truth.turn) * Rotation.from_matrix(axes)).as_matrix()
    eye = np.array([1.10, 0.0, 0.68]) + truth.camera
    external = np.column_stack([turned.T, -turned.T @ eye])
    x, y, w = external @ np.column_stack([corners, np.ones(len(corners))]).T
    x, y = x / w, y / w
    radial = 1 + truth.k1 * (x * x + y * y)
    focal = 415.0 * (1 + truth.focal)
    return np.column_stack([focal * x * radial + 111.5 + truth.offset[0], focal * y * radial + 111.5 + truth.offset[1]])


def places(case: CameraCase, rng: np.random.Generator) -> list[RestPose]:
    """The object put down at random, where all of it is in the picture. Raises ValueError where it never is."""
    found = []
    for number in range(case.count):
        truth = case.truth
        if case.moved and number >= case.moved[0]:
            truth = truth + case.moved[1]
        for _ in range(ATTEMPTS):
            corners, position, turn = put_down(case, truth, rng)
            seen = pixels(truth, corners)
            if (seen > 2).all() and (seen < 222).all():
                break
        else:
            raise ValueError(f"place {number}: expected an object in the picture, got none in {ATTEMPTS} attempts")
        found.append(_seen(case, f"place {number}", seen, position, turn, rng))
    return found


def put_down(case: CameraCase, truth: Truth, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Corners (8, 3) m, middle (3,) m and turn of the object, flat on the table or on what stands there."""
    half = np.asarray(case.domain.half_size) + np.asarray(truth.size) / 2
    if case.domain.start.quarter_turns:
        down = Rotation.from_euler("xy", rng.integers(0, 4, 2) * np.pi / 2)
    else:
        down = Rotation.identity()
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)) * down
    x, y, top = rng.uniform(0.36, 0.66), rng.uniform(-0.19, 0.19), 0.0
    for box in case.domain.obstacles:
        reach = np.asarray(box.half_size[:2]) + 0.065
        if (
            abs(y - box.centre[1]) < reach[1] and abs(x - box.centre[0]) < reach[0]
        ):  # on the middle of it, not on its edge
            top = box.centre[2] + box.half_size[2]
            x, y = np.clip(x, 0.42, 0.58), box.centre[1] + 0.2 * (y - box.centre[1])
    local = SIGNS * half
    local[3] *= 1 - case.dent / np.abs(local[3])
    flat = turn.apply(local)
    middle = np.array([x - MIDDLE[0], y - MIDDLE[1], top - turn.apply(SIGNS * half)[:, 2].min()])
    table = Rotation.from_rotvec([*truth.tilt, 0.0])
    foot = np.array([*MIDDLE, truth.height])
    return table.apply(flat + middle) + foot, table.apply(middle) + foot, table * turn


def _seen(
    case: CameraCase, name: str, seen: np.ndarray, position: np.ndarray, turn: Rotation, rng: np.random.Generator
) -> RestPose:
    d = case.detector
    off = (
        d.own * rng.standard_normal((8, 2))
        + d.shared * rng.standard_normal(2)
        + d.scatter * rng.standard_normal((8, 2))
    )
    off[rng.random(8) < d.gross[0]] += d.gross[1] * rng.standard_normal(2)
    error, pose = np.full(8, d.scatter), {}
    if d.measured:
        tipped = Rotation.from_rotvec(d.measured[1] * rng.standard_normal(3)) * turn
        pose = {"position": position + d.measured[0] * rng.standard_normal(3), "rotation": tipped.as_matrix()}
    return RestPose(name, seen + off, error, case.domain, **pose)
