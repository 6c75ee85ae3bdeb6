"""Keypoint outliers: now and then a corner is somewhere else altogether."""

from __future__ import annotations

import numpy as np

from np_description.keypoints import COUNT
from sim2real.effects.record import Quantity
from sim2real.effects.view_record import Disturbance, Part, Seen, ViewRecord


def _move(d: Disturbance) -> np.ndarray:
    is_gross = d.rng.random(COUNT) < d.given["share"]
    return is_gross[..., None] * d.given["size"] * d.rng.standard_normal((COUNT, 2))


RECORD = ViewRecord(
    "keypoint_outliers",
    Part.KEYPOINTS,
    (Quantity("share", "1", 0.0, 0.5), Quantity("size", "px", 0.0, 100.0)),
    Seen("1", 0.01),
    "{share:%} of the corners are found elsewhere, {size:px} away",
    move=_move,
)
