"""Which corners the hand hides from the camera: rays that pass through boxes about the fingers, the hand's housing and the wrist."""

from __future__ import annotations

import numpy as np

from np_description.hand import FLAT_HAND
from np_description.panda import NOMINAL

_TCP = NOMINAL.frames["hand_tcp"].position[2]
_SLIDE = NOMINAL.frames["hand_finger1"].position[2] - _TCP
WRIST = (0.0, 0.0, -0.13 - _TCP), (0.055, 0.055, 0.1)
"""m: centre and half sides of a box within the last link and its flange, over the housing."""
BOXES = np.array(
    [
        [(0.0, 0.0, _SLIDE + FLAT_HAND.tip.centre[2]), np.multiply(FLAT_HAND.tip.half_size, (1, 2, 1))],
        [(0.0, 0.0, _SLIDE + 0.0215), (0.0085, 0.022, 0.023)],  # both shafts, between slide and pads
        *([np.add(box.centre, (0.0, 0.0, -_TCP)), box.half_size] for box in FLAT_HAND.housing),
        WRIST,
    ]
)
"""m (5, 2, 3): centre and half sides of each, in the frame of the point between the closed fingertips."""
NEAR = 0.995  # of a ray, up to which something is in front of the corner: what touches its face does not hide it


def hidden(eye: np.ndarray, corners: np.ndarray, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Corners (n, 3) m that an eye at (3,) m does not see, bool (n,), with the hand's tool point at (3,) m, turned by (3, 3), base frame."""
    start, ends = (eye - position) @ rotation, (corners - position) @ rotation
    way = ends - start
    with np.errstate(divide="ignore", invalid="ignore"):
        edges = (BOXES[:, None, 0] + np.array([-1.0, 1.0])[:, None, None, None] * BOXES[:, None, 1] - start) / way
    enters, leaves = edges.min(axis=0).max(axis=-1), edges.max(axis=0).min(axis=-1)
    return ((enters < leaves) & (leaves > 0.0) & (enters < NEAR)).any(axis=0)
