"""Camera intrinsics: another focal length, another centre of the image."""

from __future__ import annotations

import numpy as np

from np_common.rotations import namespace
from np_description.camera import Camera
from sim2real.effects.record import Quantity
from sim2real.effects.view_record import Given, Part, Seen, ViewRecord


def _lens(pixels: np.ndarray, camera: Camera, given: Given) -> np.ndarray:
    scale = 1.0 + given["focal"]
    u = camera.cx + scale * (pixels[..., 0] - camera.cx) + given["centre_u"]
    v = camera.cy + scale * (pixels[..., 1] - camera.cy) + given["centre_v"]
    return namespace(pixels).stack([u, v], axis=-1)


RECORD = ViewRecord(
    "camera_intrinsics",
    Part.CAMERA,
    (
        Quantity("focal", "1", -0.1, 0.1),
        Quantity("centre_u", "px", -20.0, 20.0),
        Quantity("centre_v", "px", -20.0, 20.0),
    ),
    Seen("1", 0.004),
    "the camera's focal length is {focal:% more/less}, its centre {centre_u:px}, {centre_v:px} to the right and below",
    lens=_lens,
)
