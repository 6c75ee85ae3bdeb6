"""A recording of a rendered board, such as an operator makes: the arm rests, an image is taken, the arm goes
on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from np_description.panda import STATE_NAMES
from np_description.scene import CAMERA_NAME
from np_evaluation.calibration_trial.board_scene import BoardScene
from np_perception.camera.rectify import Rectifier, view_camera
from np_record.bag_writer import BagWriter
from np_record.topics import BY_NAME
from np_ros.messages import camera_info_message, image_message, joint_state_message, serialize

PERIOD = 20_000_000  # ns between joint states
REST, MOVE = 60, 5  # joint states of a rest, and of the way to the next


def record_rests(
    path: str | Path,
    scene: BoardScene,
    reported: Sequence[np.ndarray],
    actual: Sequence[np.ndarray] | None = None,
    images: int = 1,
) -> Path:
    """Write a bag in which the arm rests at each posture and the camera takes images there; its path.

    reported: joints (7,) rad as joint_states has them; actual: where the arm really is. Raises OSError.
    """
    writer = BagWriter(path, {"rendered": True})
    rectify = Rectifier(scene.lens, view_camera("calibration"))

    def write(name: str, stamp: int, message) -> None:
        writer.write(stamp, BY_NAME[name], serialize(message))

    stamp = 0
    for joints, truth in zip(reported, reported if actual is None else actual, strict=True):
        at = [REST - 5 - 10 * i for i in reversed(range(images))]
        for step in range(REST + MOVE):
            speed = np.where(np.arange(9) < 7, 0.0 if step < REST else 0.3, 0.0)
            write(
                "joint_states",
                stamp,
                joint_state_message(stamp, STATE_NAMES, [*joints, 0, 0], speed, np.zeros(9)),
            )
            if step in at:
                view = rectify(scene.render(truth))
                write(
                    "camera/camera_info",
                    stamp,
                    camera_info_message(stamp, CAMERA_NAME, rectify.camera, rectify.turn),
                )
                write("camera/image_raw", stamp, image_message(stamp, CAMERA_NAME, view))
            stamp += PERIOD
    writer.close()
    return Path(path)
