"""The picture of a calibration trial: a card's corners in an image before and after."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from np_common.rotations import matrix_from_vector
from np_description.calibration import Calibration
from np_description.camera import CAMERA
from np_description.domains import CARD
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL
from np_evaluation.calibration_trial.board_scene import D435, BoardScene, table_mount
from np_evaluation.calibration_trial.trial import POSITION_SPREAD, ROTATION_SPREAD, card_poses
from np_perception.calibration.board import Board
from np_perception.camera.rectify import Rectifier


def picture(calibration: Calibration, number: int, seed: int, file: Path) -> None:
    """What the policies see of the card through the calibrated camera, and where its corners are projected
    to."""
    rng = np.random.default_rng((seed, number))
    position = np.asarray(CAMERA.position) + rng.normal(0, POSITION_SPREAD, 3)
    rotation = np.asarray(CAMERA.rotation) @ matrix_from_vector(rng.normal(0, ROTATION_SPREAD, 3))
    board, pose = Board(), card_poses()[9]
    points = box_keypoints(np.asarray(CARD.half_size), pose.position, pose.quaternion)
    away = table_mount(board)
    away = replace(away, position=away.position + [0.0, 0.27, 0.0])
    with closing(BoardScene(board, away, position, rotation, in_hand=False)) as scene:
        scene.place_card(pose)
        raw = scene.render(NOMINAL.ready)
    panels = []
    for camera, turn, title in (
        (CAMERA, None, "uncalibrated"),
        (calibration.camera, calibration.turn, "calibrated"),
    ):
        view = cv2.resize(Rectifier(D435, camera, turn)(raw), None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
        for u, v in camera.project(points)[0]:
            cv2.drawMarker(view, (round(3 * u + 1), round(3 * v + 1)), (255, 0, 255), cv2.MARKER_TILTED_CROSS, 14, 2)
        cv2.putText(
            view,
            f"{title}: crosses are projected corners",
            (8, 22),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.6,
            (0, 0, 0),
            2,
        )
        panels.append(view)
    cv2.imwrite(str(file), np.hstack(panels)[..., ::-1])
