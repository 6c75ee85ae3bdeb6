"""Keypoint noise: every corner scatters, each image anew or with a memory of the one before."""

from __future__ import annotations

from math import sqrt

import numpy as np

from np_description.keypoints import COUNT
from sim2real.effects.effect import DetectionLimit, Disturbance, Effect, EffectTarget, Quantity


def _move(d: Disturbance) -> np.ndarray:
    """Autoregressive of first order, with `spread` for its own standard deviation from the first image on."""
    memory, spread = d.quantities["memory"], d.quantities["spread"]
    fresh = spread * d.rng.standard_normal((COUNT, 2))
    return memory * d.last + sqrt(1.0 - memory**2) * fresh if d.last.any() else fresh


EFFECT = Effect(
    "keypoint_noise",
    EffectTarget.KEYPOINTS,
    (Quantity("spread", "px", 0.0, 20.0), Quantity("memory", "1", 0.0, 0.99)),
    detection_limit=DetectionLimit("px", 0.5, largest=8.0),
    sentence_template="corners scatter by {spread:px}, each image keeping {memory:%} of the one before",
    move_keypoints=_move,
    has_memory=True,
)
