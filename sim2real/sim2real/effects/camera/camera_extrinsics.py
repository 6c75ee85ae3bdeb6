"""Camera extrinsics: the camera stands elsewhere than its calibration says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from np_common.rotations import matrix_from_vector
from np_description.camera import Camera
from sim2real.effects.record import Quantity
from sim2real.effects.view_record import Given, Part, Seen, ViewRecord


def _moved(camera: Camera, given: Given) -> Camera:
    """Moved by x, y, z and turned by the rotation vector, both in axes of the base."""
    turn = matrix_from_vector(np.array([given["turn_x"], given["turn_y"], given["turn_z"]]))
    position = np.asarray(camera.position) + [given["x"], given["y"], given["z"]]
    rotation = turn @ np.asarray(camera.rotation)
    return replace(camera, position=tuple(position.tolist()), rotation=tuple(map(tuple, rotation.tolist())))


RECORD = ViewRecord(
    "camera_extrinsics",
    Part.CAMERA,
    (
        *(Quantity(axis, "m", -0.1, 0.1) for axis in "xyz"),
        *(Quantity(f"turn_{axis}", "rad", -0.2, 0.2) for axis in "xyz"),
    ),
    Seen("m", 0.002),
    "the camera is {x:mm}, {y:mm}, {z:mm} from where it is believed to be (x, y, z), and turned by {turn_x:deg}, {turn_y:deg}, "
    "{turn_z:deg}",
    pose=_moved,
)
