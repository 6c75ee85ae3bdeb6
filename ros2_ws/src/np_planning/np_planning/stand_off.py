"""Where a hand stands before a face of the object: as far from it as in training, whatever the object's size. NumPy or PyTorch."""

from __future__ import annotations

import numpy as np

from np_common.rotations import matrix_from_quaternion, namespace
from np_description.domains import Task
from np_description.hand import BoxShape, Shape
from np_description.panda import NOMINAL

CLEARANCE = 0.004  # m, of the fingers from the face, where training lets the hand stand

_FINGER_BASE = np.subtract(NOMINAL.frames["hand_finger1"].position, NOMINAL.frames["hand_tcp"].position)


def array_like(constant, array):
    """A constant as an array of the other's kind."""
    xp = namespace(array)
    return (
        np.asarray(constant) if xp is np else xp.as_tensor(np.asarray(constant), dtype=array.dtype, device=array.device)
    )


def retreat(domain: Task, position, quaternion, hand, rotation, opening, half_size=None):
    """The way (..., 3) m, along the face's normal, from a hand that touches the object to where training lets it stand; zeros for fingers
    that are that far away. Arguments as of `finger_gap`."""
    apart, normal = finger_gap(domain, position, quaternion, hand, rotation, opening, half_size)
    return (CLEARANCE - apart).clip(min=0.0)[..., None] * normal


def finger_gap(domain: Task, position, quaternion, hand, rotation, opening, half_size=None):
    """How far (...) m the fingers of a hand are from the plane of the face before which it stands, negative beyond it; the normal
    (..., 3) of that face, which is the one that the ray from the object's centre to the hand leaves.

    position (..., 3) m, quaternion (..., 4): of the object; hand (..., 3) m, rotation (..., 3, 3): T_E; opening (...) m of each finger;
    half_size (..., 3) m: of the object, where it is not the domain's. All in the base frame.
    """
    turn = matrix_from_quaternion(quaternion)
    half = array_like(domain.half_size, hand) if half_size is None else half_size
    local = ((hand - position)[..., None] * turn).sum(-2)
    face = array_like(np.eye(3), hand)[abs(local / half).argmax(-1)]
    outwards = face * (1.0 - 2.0 * (local < 0))
    normal = (turn * outwards[..., None, :]).sum(-1)
    apart = (outwards * local).sum(-1) - (face * half).sum(-1)
    return apart - _reach(domain, rotation, opening, -normal), normal


def _reach(domain: Task, rotation, opening, direction):
    """How far (...) m the fingers reach along a direction (..., 3) from T_E."""
    xp, local, farthest = namespace(direction), (direction[..., None] * rotation).sum(-2), None
    for side in (1.0, -1.0):  # the second finger: half a turn about z
        turned = local * array_like((side, side, 1.0), local)
        base = (local * array_like(_FINGER_BASE, local)).sum(-1) + opening * turned[..., 1]
        for shape in domain.contact.hand.finger:
            reach = base + _support(shape, turned)
            farthest = reach if farthest is None else xp.maximum(farthest, reach)
    return farthest


def _support(shape: Shape, direction):
    """How far (...) m a shape reaches along a direction (..., 3) from its body's origin."""
    centre = (direction * array_like(shape.centre, direction)).sum(-1)
    if isinstance(shape, BoxShape):
        return centre + (abs(direction) * array_like(shape.half_size, direction)).sum(-1)
    return centre + abs((direction * array_like(shape.half_axis, direction)).sum(-1)) + shape.radius
