"""The fingertips as one block: closed pads of the flat hand, and how the hand stands over the table."""

from __future__ import annotations

from functools import cache

import numpy as np

from np_common.rotations import matrix_from_vector
from np_control.kinematics import forward_kinematics
from np_description.hand import FLAT_HAND
from np_description.panda import NOMINAL

_PAD = FLAT_HAND.tip
_SLIDE = NOMINAL.frames["hand_finger1"].position[2] - NOMINAL.frames["hand_tcp"].position[2]
BEYOND = _SLIDE + _PAD.centre[2] + _PAD.half_size[2]
"""m by which the pads reach beyond T_E."""
HALF = np.array([_PAD.half_size[0], 2 * _PAD.half_size[1]])
"""m: half the block's sides along x and y of the hand; one pad on either side of y = 0."""
CORNERS = np.array([[x, y, BEYOND] for x in (-HALF[0], HALF[0]) for y in (-HALF[1], HALF[1])])
"""Corners (4, 3) m of the block's end, in the frame of T_E."""
GRIP = 0.042
"""m below the top of an object, down to which the tip reaches beside it: the hand's housing is 46 mm behind the tip."""
EDGE = 0.016
"""m below the top of an object, down to which nothing but the pads' edge touches a face that is pushed: from 21 mm behind the end on, the
finger's shaft stands out further, and a force that acts up there is another one by the joints."""
HOUSING = np.max([box.half_size[:2] for box in FLAT_HAND.housing], axis=0)
"""m: half the housing's sides along x and y of the hand."""
RADIUS = float(np.hypot(*HALF))
"""m from the block's axis to its corners."""


@cache
def _ready_rotation() -> np.ndarray:
    return forward_kinematics(NOMINAL.ready)[1]


def upright_rotation(yaw: float) -> np.ndarray:
    """Rotation (3, 3) of T_E that points down, turned by `yaw` rad from where the ready posture has it."""
    return matrix_from_vector(np.array([0.0, 0.0, yaw])) @ _ready_rotation()


def leading_yaw(direction: np.ndarray) -> float:
    """Yaw rad of the hand, the smallest, at which one of the block's upright edges leads in a `direction` (2,) of the table's plane.

    An edge touches a face in one line whatever the face's angle is, up to 30 degrees.
    """
    ahead = np.arctan2(direction[1], direction[0])
    corners = CORNERS @ upright_rotation(0.0).T
    turns = np.angle(np.exp(1j * (ahead - np.arctan2(corners[:, 1], corners[:, 0]))))
    return float(turns[np.argmin(np.abs(turns))])


def lowest_corner(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The lowest corner (n, 3) m of the block, where T_E is at position (n, 3) m with rotation (n, 3, 3)."""
    corners = position[:, None] + np.einsum("nij,kj->nki", rotation, CORNERS)
    return corners[np.arange(len(corners)), corners[..., 2].argmin(axis=1)]
