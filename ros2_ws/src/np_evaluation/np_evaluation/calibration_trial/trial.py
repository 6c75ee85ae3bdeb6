"""Rendered cameras whose poses are known are calibrated, and results and their bounds are compared with the truth."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from np_common.rotations import matrix_from_vector, vector_from_matrix, yaw_quaternion
from np_control.kinematics import forward_kinematics, solve_ik
from np_description.calibration import Calibration
from np_description.camera import CAMERA, Camera
from np_description.domains import CARD, Pose
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL
from np_evaluation.calibration_trial.board_recording import record_rests
from np_evaluation.calibration_trial.board_scene import BoardScene, hand_mount, table_mount
from np_perception.calibration.board import Board
from np_perception.calibration.evidence import CalibrationRefusal, read_calibration_data
from np_perception.calibration.fitting import calibrate
from np_perception.pose_estimation import estimate_pose

TOUCHED = (0, 5, 18, 23, 8, 15, 2, 21)
# Of the cameras about CAMERA: m and rad, standard deviation of each axis.
POSITION_SPREAD, ROTATION_SPREAD = 0.025, np.radians(2)


@dataclass(frozen=True)
class TrialArm:
    """Errors of an arm's joint states; standard deviations."""

    name: str
    """As in the table of results."""
    offset: float
    """Of each joint, the same in every posture, rad."""
    noise: float
    """Of each joint, drawn anew in every posture, rad."""
    tip: float
    """Of a fingertip put on a corner, m."""


ARMS = (
    TrialArm("ideal", 0.0, 0.0, 0.0),
    # The arm repeats to 0.1 mm (datasheet); its absolute accuracy, which the datasheet does not give, is a
    # millimetre or so.
    TrialArm("real", 0.0003, 0.0002, 0.0005),
)


def card_poses() -> list[Pose]:
    """Poses of the card all over its start region."""
    return [
        Pose(np.array([x, y, CARD.half_size[2]]), yaw_quaternion(np.asarray(yaw)))
        for x in np.linspace(*CARD.start.x, 3)
        for y in np.linspace(*CARD.start.y, 3)
        for yaw in (0.0, 0.7)
    ]


def true_view(calibration: Calibration, position: np.ndarray, rotation: np.ndarray) -> Camera:
    """The camera whose images the camera node really publishes when it turns them by the calibration."""
    turned = rotation @ calibration.turn.T
    return replace(CAMERA, position=tuple(position.tolist()), rotation=tuple(map(tuple, turned.tolist())))


def card_errors(truth: Camera, believed: Camera) -> dict[str, float]:
    """Errors of the card's projected corners, px, and of its estimated position, mm."""
    pixels, places = [], []
    for pose in card_poses():
        points = box_keypoints(np.asarray(CARD.half_size), pose.position, pose.quaternion)
        seen = truth.project(points)[0]
        pixels.append(np.linalg.norm(seen - believed.project(points)[0], axis=1))
        estimate = estimate_pose(np.column_stack([seen, np.ones(8)]), CARD, camera=believed, max_rms=50.0)
        places.append(np.linalg.norm(estimate.pose.position - pose.position))
    return {
        "keypoint_mean_px": float(np.mean(pixels)),
        "keypoint_max_px": float(np.max(pixels)),
        "object_mean_mm": 1e3 * float(np.mean(places)),
        "object_max_mm": 1e3 * float(np.max(places)),
    }


def touch_postures(scene: BoardScene, missed: np.ndarray) -> list[np.ndarray]:
    """Joints (7,) at which the fingertips stand on each of the corners TOUCHED, but for `missed` (n, 3) m."""
    down = forward_kinematics(NOMINAL.ready)[1]
    points = scene.board.corners[list(TOUCHED)] @ scene.mount.rotation.T + scene.mount.position + missed
    return list(
        solve_ik(
            np.tile(NOMINAL.ready, (len(points), 1)),
            points,
            np.tile(down, (len(points), 1, 1)),
            iterations=40,
        )
    )


def run_trial(number: int, arm: TrialArm, seed: int, views: int, folder: Path) -> tuple[list[dict], Calibration]:
    """Calibrate camera `number` by both methods, from bags; what came out beside the truth, and the one by
    hand."""
    rng = np.random.default_rng((seed, number))
    position = np.asarray(CAMERA.position) + rng.normal(0, POSITION_SPREAD, 3)
    rotation = np.asarray(CAMERA.rotation) @ matrix_from_vector(rng.normal(0, ROTATION_SPREAD, 3))
    board, offset = Board(), rng.normal(0, arm.offset, 7)

    def actual(postures: list[np.ndarray]) -> list[np.ndarray]:
        return [q + offset + rng.normal(0, arm.noise, 7) for q in postures]

    with closing(BoardScene(board, hand_mount(board), position, rotation, seed=number)) as scene:
        postures = scene.postures(views, rng)
        held = record_rests(folder / f"{arm.name}_{number}_hand", scene, postures, actual(postures))
    mount = table_mount(board)
    with closing(BoardScene(board, mount, position, rotation, in_hand=False, seed=number)) as scene:
        lying = record_rests(folder / f"{arm.name}_{number}_table", scene, [NOMINAL.ready], images=3)
        # The tip really stands near the corner; joint_states differ a little.
        touching = touch_postures(scene, rng.normal(0, arm.tip, (len(TOUCHED), 3)))
        reported = [q - offset - rng.normal(0, arm.noise, 7) for q in touching]
        touched = record_rests(folder / f"{arm.name}_{number}_touched", scene, reported, touching)
    now, results, kept = datetime.now(UTC), [], None
    for method, arguments in (
        ("hand", dict(table=read_calibration_data(lying, board))),
        ("touched", dict(touched=TOUCHED)),
    ):
        row: dict[str, object] = {
            "camera": number,
            "arm": arm.name,
            "method": method,
            "displaced_mm": 1e3 * float(np.linalg.norm(position - CAMERA.position)),
            "displaced_deg": _degrees(rotation, np.asarray(CAMERA.rotation)),
        }
        evidence = read_calibration_data(held if method == "hand" else touched, board)
        try:
            result = calibrate(evidence, board, now, **arguments)
        except CalibrationRefusal as error:
            results.append({**row, "refused": str(error)})
            continue
        calibration, errors = result.calibration, result.calibration.errors
        kept = calibration if method == "hand" else kept
        row |= {
            "error_mm": 1e3 * float(np.linalg.norm(calibration.position - position)),
            "error_95_mm": 1e3 * errors.position_95,
            "error_deg": _degrees(calibration.rotation, rotation),
            "error_95_deg": float(np.degrees(errors.rotation_95)),
            "keypoint_95_px": errors.keypoint_95,
            "reprojection_rms_px": errors.reprojection_rms,
            "views": errors.views,
            "corners": errors.corners,
            "board_scale": [result.check.scale, result.check.scale_95],
            "left_out": result.fit.left_out,
            **({} if method == "touched" else {"focal": [result.check.focal, result.check.focal_95]}),
            **card_errors(true_view(calibration, position, rotation), calibration.camera),
        }
        if (table := calibration.table) is not None:
            true_height = 1e-3  # of the board's upper side
            row |= {
                "table_error_mm": 1e3 * abs(table.height - true_height),
                "table_95_mm": 1e3 * table.height_95,
            }
        results.append(row)
    uncalibrated = replace(CAMERA, position=tuple(position.tolist()), rotation=tuple(map(tuple, rotation.tolist())))
    results[0]["uncalibrated"] = card_errors(uncalibrated, CAMERA)
    return results, kept


def _degrees(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(vector_from_matrix(a @ b.T))))


def summary(rows: list[dict]) -> dict[str, object]:
    """Medians, maxima, and how often the stated bound held, by arm and method."""
    found: dict[str, object] = {}
    for arm, method in sorted({(row["arm"], row["method"]) for row in rows}):
        own = [row for row in rows if (row["arm"], row["method"]) == (arm, method)]
        good = [row for row in own if "refused" not in row]

        def column(name: str, good=good) -> np.ndarray:
            return np.array([row[name] for row in good if name in row])

        entry: dict[str, object] = {"cameras": len(own), "refused": len(own) - len(good)}
        for name, bound in (
            ("error_mm", "error_95_mm"),
            ("error_deg", "error_95_deg"),
            ("keypoint_max_px", "keypoint_95_px"),
            ("table_error_mm", "table_95_mm"),
        ):
            if len(column(name)):
                entry[name] = {
                    "median": float(np.median(column(name))),
                    "max": float(column(name).max()),
                    "claimed_95_median": float(np.median(column(bound))),
                    "within_claim": f"{int((column(name) <= column(bound)).sum())} of {len(column(name))}",
                }
        for name in ("keypoint_mean_px", "object_mean_mm", "object_max_mm") if good else ():
            entry[name] = {"median": float(np.median(column(name))), "max": float(column(name).max())}
        found[f"{arm} arm, {method}"] = entry
    return found
