"""Keypoint bias: all corners are found to one side."""

from __future__ import annotations

import numpy as np

from np_description.keypoints import COUNT
from sim2real.effects.record import Quantity
from sim2real.effects.view_record import Disturbance, Part, Seen, ViewRecord


def _move(d: Disturbance) -> np.ndarray:
    return np.tile([d.given["u"], d.given["v"]], (COUNT, 1))


RECORD = ViewRecord(
    "keypoint_bias",
    Part.KEYPOINTS,
    (Quantity("u", "px", -20.0, 20.0), Quantity("v", "px", -20.0, 20.0)),
    Seen("px", 0.7),
    "corners are found {u:px right/left} and {v:px below/above} of where they are",
    move=_move,
)
