"""Keypoint outliers: now and then a corner is somewhere else altogether."""

from __future__ import annotations

import numpy as np

from np_description.keypoints import COUNT
from sim2real.effects.effect import DetectionLimit, Disturbance, Effect, EffectTarget, Quantity


def _move(d: Disturbance) -> np.ndarray:
    is_gross = d.rng.random(COUNT) < d.quantities["share"]
    return is_gross[..., None] * d.quantities["size"] * d.rng.standard_normal((COUNT, 2))


EFFECT = Effect(
    "keypoint_outliers",
    EffectTarget.KEYPOINTS,
    (Quantity("share", "1", 0.0, 0.5), Quantity("size", "px", 0.0, 100.0)),
    detection_limit=DetectionLimit("1", 0.01, largest=8.0),
    sentence_template="{share:%} of the corners are found elsewhere, {size:px} away",
    move_keypoints=_move,
)
