"""What the policies see: one definition for training and nodes, NumPy or PyTorch, any leading shape.

The post-contact state is Table I of the paper: q 9, dq 9, keypoints 16, goal keypoints 16, T_E 9 (position and the
6D rotation), last action 20. Every group is scaled by constants of the robot and camera, so that no statistics have
to travel with the weights; the goal enters relative to the keypoints, enlarged, because success is decided by
differences of a few pixels.
"""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace, six_from_matrix
from np_description.camera import CAMERA
from np_description.panda import FINGER_MAX, NOMINAL

POST_SIZE = 9 + 9 + 16 + 16 + 9 + 20
STUDENT_SIZE = 16 + 16
# Weights are refused that were trained with another version. Raise one whenever the numbers that its function returns for
# equal inputs change: order, scale, centre or meaning of an entry; a test holds the version to those numbers.
POST_VERSION = 1
STUDENT_VERSION = 1
GOAL_GAIN = 5.0

_CENTRE = np.concatenate([(NOMINAL.position_upper + NOMINAL.position_lower) / 2, [FINGER_MAX / 2] * 2])
_RANGE = np.concatenate([(NOMINAL.position_upper - NOMINAL.position_lower) / 2, [FINGER_MAX / 2] * 2])
_SPEED = np.concatenate([NOMINAL.velocity_limit / 2, [0.1] * 2])
_TCP_CENTRE, _TCP_RANGE = np.array([0.5, 0.0, 0.1]), 0.2


def _like(constant, array):
    xp = namespace(array)
    return constant if xp is np else xp.as_tensor(constant, dtype=array.dtype, device=array.device)


def post_contact_observation(q, dq, keypoints, goal_keypoints, position, rotation, last_action):
    """The post-contact policy's input (..., 79).

    q, dq (..., 9): 7 joints rad, rad/s and 2 fingers m, m/s; keypoints, goal_keypoints (..., 8, 2) normalised image
    coordinates (`Camera.normalise`); position (..., 3) m and rotation (..., 3, 3) of T_E; last_action (..., 20) in [-1, 1].
    """
    xp = namespace(q)
    pixels, goal = (k.reshape(k.shape[:-2] + (16,)) for k in (keypoints, goal_keypoints))
    return xp.concatenate(
        [
            (q - _like(_CENTRE, q)) / _like(_RANGE, q),
            dq / _like(_SPEED, q),
            pixels,
            (goal - pixels) * GOAL_GAIN,
            (position - _like(_TCP_CENTRE, q)) / _TCP_RANGE,
            six_from_matrix(rotation),
            last_action,
        ],
        axis=-1,
    )


def student_observation(keypoints, goal_keypoints):
    """The pre-contact student's input (..., 32), from normalised keypoints (..., 8, 2)."""
    xp = namespace(keypoints)
    pixels, goal = (k.reshape(k.shape[:-2] + (16,)) for k in (keypoints, goal_keypoints))
    return xp.concatenate([pixels, (goal - pixels) * GOAL_GAIN], axis=-1)


def normalise_keypoints(points):
    """Normalised image coordinates (..., 8, 2) of corners (..., 8, 3) m in the base frame."""
    return CAMERA.normalise(CAMERA.project(points)[0])
