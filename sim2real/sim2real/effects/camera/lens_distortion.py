"""Lens distortion that is not corrected (Brown 1966, Conrady 1919; as OpenCV and ROS's plumb_bob have it)."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from np_description.camera import Camera
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity, QuantityValues


def _distort(pixels: np.ndarray, camera: Camera, values: QuantityValues) -> np.ndarray:
    x = (pixels[..., 0] - camera.cx) / camera.fx
    y = (pixels[..., 1] - camera.cy) / camera.fy
    r2 = x**2 + y**2
    radial = 1.0 + values["k1"] * r2 + values["k2"] * r2**2
    p1, p2 = values["p1"], values["p2"]
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return namespace(pixels).stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy], axis=-1)


EFFECT = Effect(
    "lens_distortion",
    EffectTarget.CAMERA,
    (
        Quantity("k1", "1", -1.0, 1.0),
        Quantity("k2", "1", -4.0, 4.0),
        Quantity("p1", "1", -0.05, 0.05),
        Quantity("p2", "1", -0.05, 0.05),
    ),
    detection_limit=DetectionLimit("px at the corner of the image", 1.0, largest=8.0),
    sentence_template="the lens distorts: k1 {k1:1}, k2 {k2:1}, p1 {p1:1}, p2 {p2:1}",
    lens=_distort,
)
