"""Camera intrinsics: another focal length, another centre of the image."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from np_description.camera import Camera
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity, QuantityValues


def _change_lens(pixels: np.ndarray, camera: Camera, values: QuantityValues) -> np.ndarray:
    scale = 1.0 + values["focal"]
    u = camera.cx + scale * (pixels[..., 0] - camera.cx) + values["centre_u"]
    v = camera.cy + scale * (pixels[..., 1] - camera.cy) + values["centre_v"]
    return namespace(pixels).stack([u, v], axis=-1)


EFFECT = Effect(
    "camera_intrinsics",
    EffectTarget.CAMERA,
    (
        Quantity("focal", "1", -0.1, 0.1),
        Quantity("centre_u", "px", -20.0, 20.0),
        Quantity("centre_v", "px", -20.0, 20.0),
    ),
    detection_limit=DetectionLimit("1", 0.004, largest=8.0),
    sentence_template="the camera's focal length is {focal:% more/less}, its centre {centre_u:px}, {centre_v:px} to the right and below",
    lens=_change_lens,
)
