"""Keypoint bias: all corners are found to one side."""

from __future__ import annotations

import numpy as np

from np_description.keypoints import COUNT
from sim2real.effects.effect import DetectionLimit, Disturbance, Effect, EffectTarget, Quantity


def _move(d: Disturbance) -> np.ndarray:
    return np.tile([d.quantities["u"], d.quantities["v"]], (COUNT, 1))


EFFECT = Effect(
    "keypoint_bias",
    EffectTarget.KEYPOINTS,
    (Quantity("u", "px", -20.0, 20.0), Quantity("v", "px", -20.0, 20.0)),
    detection_limit=DetectionLimit("px", 0.7, largest=8.0),
    sentence_template="corners are found {u:px right/left} and {v:px below/above} of where they are",
    move_keypoints=_move,
)
