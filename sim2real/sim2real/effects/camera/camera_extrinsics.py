"""Camera extrinsics: the camera's pose is not that of its calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from np_common.rotations import matrix_from_vector
from np_description.camera import Camera
from sim2real.effects.effect import DetectionLimit, Effect, EffectTarget, Quantity, QuantityValues


def _move_camera(camera: Camera, values: QuantityValues) -> Camera:
    """Moved by x, y, z and turned by the rotation vector, both in axes of the base."""
    turn = matrix_from_vector(np.array([values["turn_x"], values["turn_y"], values["turn_z"]]))
    position = np.asarray(camera.position) + [values["x"], values["y"], values["z"]]
    rotation = turn @ np.asarray(camera.rotation)
    return replace(camera, position=tuple(position.tolist()), rotation=tuple(map(tuple, rotation.tolist())))


EFFECT = Effect(
    "camera_extrinsics",
    EffectTarget.CAMERA,
    (
        *(Quantity(axis, "m", -0.1, 0.1) for axis in "xyz"),
        *(Quantity(f"turn_{axis}", "rad", -0.2, 0.2) for axis in "xyz"),
    ),
    detection_limit=DetectionLimit("m", 0.002, largest=8.0),
    sentence_template="the camera is {x:mm}, {y:mm}, {z:mm} from its nominal position (x, y, z), and turned by {turn_x:deg}, {turn_y:deg}, "
    "{turn_z:deg}",
    camera_pose=_move_camera,
)
