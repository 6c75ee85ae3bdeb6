"""Where a hand stands before a face of the object: as far from it as in training, whatever the object's size."""

from __future__ import annotations

import numpy as np

from np_description.domains import Domain, Pose
from np_description.hand import BoxShape, Shape
from np_description.panda import NOMINAL
from np_description.rotations import matrix_from_quaternion

CLEARANCE = (
    0.004  # m, of the fingers from the face, where training lets the hand stand (np_training.environment.contact)
)

_TCP = np.asarray(NOMINAL.frames["hand_tcp"].position)
_FINGER_BASE = np.asarray(NOMINAL.frames["hand_finger1"].position)


def face_before(domain: Domain, objekt: Pose, point: np.ndarray) -> tuple[np.ndarray, float]:
    """The face that a ray from the object's centre through `point` (3,) m leaves: its normal (3,) in the base frame, and how far
    along it, m, the face is from the base frame's origin."""
    turn, half = matrix_from_quaternion(objekt.quaternion), np.asarray(domain.half_size)
    local = turn.T @ (point - objekt.position)
    axis = int(np.argmax(np.abs(local) / half))
    normal = turn[:, axis] * (1.0 if local[axis] >= 0 else -1.0)
    return normal, float(normal @ objekt.position + half[axis])


def gap(domain: Domain, objekt: Pose, hand: Pose, opening: float) -> tuple[float, np.ndarray]:
    """How far, m, the fingers of a hand at T_E are from the plane of the face before which it stands, negative beyond it; the face's
    normal (3,). opening: of each finger, m."""
    normal, offset = face_before(domain, objekt, hand.position)
    return float(normal @ hand.position - offset - _reach(domain, hand, opening, -normal)), normal


def _reach(domain: Domain, hand: Pose, opening: float, direction: np.ndarray) -> float:
    """How far, m, the fingers reach along a direction from T_E."""
    local = matrix_from_quaternion(hand.quaternion).T @ direction
    farthest = -np.inf
    for side in (1.0, -1.0):  # the second finger: half a turn about z
        turned = local * (side, side, 1.0)
        base = (_FINGER_BASE - _TCP) @ local + opening * turned[1]
        farthest = max(farthest, *(base + _support(shape, turned) for shape in domain.contact.hand.finger))
    return float(farthest)


def _support(shape: Shape, direction: np.ndarray) -> float:
    """How far a shape reaches along a direction from its body's origin."""
    centre = float(np.asarray(shape.centre) @ direction)
    if isinstance(shape, BoxShape):
        return centre + float(np.abs(direction) @ np.asarray(shape.half_size))
    return centre + abs(float(np.asarray(shape.half_axis) @ direction)) + shape.radius
