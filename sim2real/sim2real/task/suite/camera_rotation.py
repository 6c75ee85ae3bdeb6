"""Why a picture shows things elsewhere: a camera that stands elsewhere, or one that is turned?

Both show an object off by the same way, where it is. But a turned camera shows it from the same side as before, at a place where it is not:
its corners are then those of an object that is tilted, which one that lies flat is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from np_common.rotations import matrix_from_vector
from np_description.camera import Camera
from sim2real.task.camera.fit import evaluate_at
from sim2real.task.camera.model import HEIGHT, SHIFT, TURN, CameraScene
from sim2real.task.camera.parameters import COUNT
from sim2real.task.hypotheses import INDISTINGUISHABLE_LOG_BAYES_FACTOR
from sim2real.thresholds import THRESHOLDS

SCATTER = THRESHOLDS.camera_fit.scatter[0]
STEP, ROUNDS = 1e-4, 5  # rad of a derivative; of Newton: the picture is nearly a plane


def prefer_rotation_over_translation(
    scene: CameraScene, poses: np.ndarray, off: np.ndarray, lift: float
) -> np.ndarray | None:
    """rad (2,) about the base's x and y, by which a camera is turned that shows things off by m (2,), where that makes corners at rest more
    probable than a camera that stands elsewhere by as much; None where it does not.

    poses (k, 3): x m, y m, yaw rad nominal pose of the object; lift: m by which the table was felt to be higher.
    """
    height = scene.surface + (np.abs(scene.face[:, 2]) * scene.half).sum(axis=1)
    place = np.array([*(np.median(poses[:, :2], axis=0) - off), lift + float(np.median(height))])
    turn = _turn(scene.camera, place, off)
    shifted, rotated = np.zeros(COUNT), np.zeros(COUNT)
    shifted[SHIFT[:2]], rotated[TURN[:2]] = -off, turn
    shifted[HEIGHT] = rotated[HEIGHT] = lift
    moved = poses - np.array([*off, 0.0])
    by_place, by_turn = (evaluate_at(scene, vector, moved, SCATTER).cost for vector in (shifted, rotated))
    return turn if by_place - by_turn > INDISTINGUISHABLE_LOG_BAYES_FACTOR else None


def _turn(camera: Camera, place: np.ndarray, off: np.ndarray) -> np.ndarray:
    """rad (2,) by which a camera is turned that shows what is at a place (3,) m off by m (2,)."""
    turn = np.zeros(2)
    for _ in range(ROUNDS):
        here = _displacement(camera, place, turn)
        slopes = np.column_stack(
            [(_displacement(camera, place, turn + STEP * axis) - here) / STEP for axis in np.eye(2)]
        )
        turn = turn + np.linalg.solve(slopes, off - here)
    return turn


def _displacement(camera: Camera, place: np.ndarray, turn: np.ndarray) -> np.ndarray:
    rotation = matrix_from_vector(np.array([*turn, 0.0])) @ np.asarray(camera.rotation)
    true = replace(camera, rotation=tuple(map(tuple, rotation.tolist())))
    return camera.at_height(camera.rays(true.project(place[None])[0]), place[2])[0] - place[:2]
