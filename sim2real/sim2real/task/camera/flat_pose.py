"""How a box lies at a place: on which face, at which height, where and how turned, as far as the nominal camera shows it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from np_common.rotations import matrix_from_vector
from np_description.camera import Camera
from np_description.domains import Task
from np_description.keypoints import CORNERS
from sim2real.task.camera.rest_poses import RestPose
from sim2real.thresholds import THRESHOLDS

PLACES = THRESHOLDS.rest_poses
FACES = np.array(
    [
        matrix_from_vector(np.array(vector) * np.pi / 2)
        for vector in ((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), (0, 1, 0), (0, 3, 0))
    ]
)
"""Rotations (6, 3, 3) that put each face of the box down."""


@dataclass(frozen=True, eq=False)
class FlatPoseFit:
    """The pose of a box that lies flat."""

    face: np.ndarray
    """Rotation (3, 3) of the object before it is turned by yaw."""
    surface: float
    """Height m of its support over the table."""
    pose: np.ndarray
    """x m, y m, yaw rad (3,)."""
    off: float
    """Root mean square px over usable corners; infinite where the measured pose is not flat."""

    @property
    def is_flat(self) -> bool:
        """Whether corners are those of a box that lies flat; a camera that is as far off as they ever are leaves less."""
        return self.off <= PLACES.off


def fit_flat_pose(place: RestPose, camera: Camera) -> FlatPoseFit:
    """The way of lying that explains a place best, or the one that was measured."""
    candidates = list(_measured_pose(place) if place.position is not None else _possible_poses(place, camera))
    if not candidates:
        return FlatPoseFit(FACES[0], 0.0, np.array([0.5, 0.0, 0.0]), np.inf)
    found = (
        FlatPoseFit(face, surface, pose, _corner_error(place, camera, face, surface, pose))
        for face, surface, pose in candidates
    )
    # A measured pose gives how the box lies; the corners may then be as far off as they like.
    return next(found) if place.position is not None else min(found, key=lambda one: one.off)


def _measured_pose(place: RestPose) -> Iterator[tuple[np.ndarray, float, np.ndarray]]:
    """The way in which the measured pose lies, none where it is tilted or in the air."""
    upright = place.rotation @ np.swapaxes(FACES, 1, 2)  # what is left to do by yaw alone
    face = int(np.argmax(upright[:, 2, 2]))
    height = place.position[2] - float(np.abs(FACES[face][2]) @ np.asarray(place.domain.half_size))
    surfaces = _surfaces(place.domain, place.position[:2])
    surface = min(surfaces, key=lambda top: abs(top - height))
    if upright[face, 2, 2] >= np.cos(PLACES.lean) and abs(height - surface) <= PLACES.lifted:
        yaw = np.arctan2(upright[face, 1, 0], upright[face, 0, 0])
        yield FACES[face], surface, np.array([*place.position[:2], yaw])


def _possible_poses(place: RestPose, camera: Camera) -> Iterator[tuple[np.ndarray, float, np.ndarray]]:
    """Every face on every surface that is there, at the pose that its corners' known heights give.

    A pixel and a height make a point; the turn that brings the box nearest to its points is that of a product of complex numbers.
    """
    usable, half = place.usable, np.asarray(place.domain.half_size)
    rays = camera.rays(place.pixels[usable])
    if not (rays[:, 2] < 0).all():
        return  # above the horizon
    for surface in (0.0, *_tops(place.domain)):
        for face in FACES:
            corners = (CORNERS[usable] * half) @ face.T
            height = surface + np.abs(face[2]) @ half + corners[:, 2]
            points = camera.at_height(rays, height)
            there, own = (v[:, 0] + 1j * v[:, 1] for v in (points, corners))
            turn = np.vdot(own - own.mean(), there - there.mean())
            yaw = np.angle(turn)
            at = there.mean() - own.mean() * np.exp(1j * yaw)
            if surface in _surfaces(place.domain, (at.real, at.imag)):
                yield face, surface, np.array([at.real, at.imag, yaw])


def _tops(domain: Task) -> Sequence[float]:
    return sorted({box.centre[2] + box.half_size[2] for box in domain.obstacles})


def _surfaces(domain: Task, at: Sequence[float]) -> list[float]:
    """Heights m of what an object at (x, y) may lie on: the table, a top that is under it, or both near the top's edge."""
    found = {0.0}
    for box in domain.obstacles:
        inside = min(half - abs(x - middle) for x, middle, half in zip(at, box.centre, box.half_size[:2]))
        if inside >= -PLACES.margin:
            found.add(box.centre[2] + box.half_size[2])
        if inside > PLACES.margin:
            found.discard(0.0)
    return sorted(found)


def _corner_error(place: RestPose, camera: Camera, face: np.ndarray, surface: float, pose: np.ndarray) -> float:
    half = np.asarray(place.domain.half_size)
    spin = matrix_from_vector(np.array([0.0, 0.0, pose[2]]))
    middle = np.array([*pose[:2], surface + np.abs(face[2]) @ half])
    pixels, depth = camera.project((CORNERS * half) @ (spin @ face).T + middle)
    away = (pixels - place.pixels)[place.usable]
    if place.position is not None:  # a shift is the camera's fault, and left to the fit: of the shape alone
        away = away - np.median(away, axis=0)
    # One corner in four may be gross: the middle of the squares stands for their mean, as of a circular Gaussian.
    return float(np.sqrt(np.median((away**2).sum(axis=1)) / np.log(2))) if (depth > 0).all() else np.inf
