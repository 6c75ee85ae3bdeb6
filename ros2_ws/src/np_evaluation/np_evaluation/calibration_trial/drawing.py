"""What a calibration trial shows: errors beside their bounds, and a card's corners in an image before and after."""

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
from np_evaluation.calibration_trial.trial import ARMS, POSITION_SPREAD, ROTATION_SPREAD, card_poses
from np_perception.calibration.board import Board
from np_perception.camera.rectify import Rectifier


def draw(rows: list[dict], file: Path) -> None:
    """Errors beside their claimed bounds."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    panels = (
        ("error_mm", "error_95_mm", "camera position, mm"),
        ("error_deg", "error_95_deg", "camera rotation, degrees"),
        ("keypoint_max_px", "keypoint_95_px", "card corner, worst place, px of 224"),
    )
    groups = [(arm.name, method) for arm in ARMS for method in ("hand", "touched")]
    colours = ("#4477aa", "#66ccee", "#ee6677", "#ccbb44")
    figure, axes = pyplot.subplots(1, 3, figsize=(13, 4.6), constrained_layout=True)
    for axis, (name, bound, title) in zip(axes, panels):
        for shift, (group, colour) in enumerate(zip(groups, colours)):
            own = [row for row in rows if (row["arm"], row["method"]) == group and name in row]
            x = np.array([row["camera"] for row in own]) + 0.2 * (shift - 1.5)
            axis.plot(x, [row[name] for row in own], "o", color=colour, ms=4, label=f"{group[0]} arm, {group[1]}")
            axis.plot(x, [row[bound] for row in own], "_", color=colour, ms=7)
        axis.set(title=title, xlabel="camera", yscale="log")
        axis.grid(alpha=0.3)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, title="error; dash: claimed 95 % bound")
    figure.savefig(file, dpi=110)
    pyplot.close(figure)


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
