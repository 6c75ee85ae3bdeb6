"""`calibration_trial --out DIR`: calibrate rendered cameras whose places are known, and compare claim with
truth."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np

from np_bringup.calibration_trial.board_recording import record_rests
from np_bringup.calibration_trial.board_scene import D435, BoardScene, hand_mount, table_mount
from np_control.kinematics import forward_kinematics, solve_ik
from np_description.calibration import Calibration
from np_description.camera import CAMERA, Camera
from np_description.domains import CARD, Pose
from np_description.keypoints import box_keypoints
from np_description.panda import NOMINAL
from np_description.rotations import matrix_from_vector, vector_from_matrix, yaw_quaternion
from np_perception.calibration.board import Board
from np_perception.calibration.evidence import CalibrationRefused, read_evidence
from np_perception.calibration.fitting import calibrate
from np_perception.camera.rectify import Rectifier
from np_perception.pose_estimation import estimate_pose
from np_record.command import Progress, origin

TOUCHED = (0, 5, 18, 23, 8, 15, 2, 21)
# Of the cameras about CAMERA: m and rad, standard deviation of each axis.
POSITION_SPREAD, ROTATION_SPREAD = 0.025, np.radians(2)


@dataclass(frozen=True)
class Arm:
    """How far the arm is from what its joint states say. offset rad: of each joint, the same in every
    posture; noise rad: of each joint, another in every posture; standard deviations. tip m: how well a
    fingertip is put on a corner.
    """

    name: str
    offset: float
    noise: float
    tip: float


ARMS = (
    Arm("ideal", 0.0, 0.0, 0.0),
    # The arm repeats to 0.1 mm (datasheet); its absolute accuracy, which the datasheet does not give, is a
    # millimetre or so.
    Arm("real", 0.0003, 0.0002, 0.0005),
)


def card_poses() -> list[Pose]:
    """Where the card lies, all over its start region."""
    return [
        Pose(np.array([x, y, CARD.half_size[2]]), yaw_quaternion(np.asarray(yaw)))
        for x in np.linspace(*CARD.start.x, 3)
        for y in np.linspace(*CARD.start.y, 3)
        for yaw in (0.0, 0.7)
    ]


def true_view(calibration: Calibration, position: np.ndarray, rotation: np.ndarray) -> Camera:
    """The camera whose images the camera node really publishes when it turns them as the calibration says."""
    turned = rotation @ calibration.turn.T
    return replace(CAMERA, position=tuple(position.tolist()), rotation=tuple(map(tuple, turned.tolist())))


def card_errors(truth: Camera, believed: Camera) -> dict[str, float]:
    """By how much the card's corners are elsewhere than projected, px, and where it is taken to be, mm."""
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


def one(number: int, arm: Arm, seed: int, views: int, folder: Path) -> tuple[list[dict], Calibration]:
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
        # The tip really stands near the corner; joint_states say something a little else.
        touching = touch_postures(scene, rng.normal(0, arm.tip, (len(TOUCHED), 3)))
        reported = [q - offset - rng.normal(0, arm.noise, 7) for q in touching]
        touched = record_rests(folder / f"{arm.name}_{number}_touched", scene, reported, touching)
    now, results, kept = datetime.now(UTC), [], None
    for method, arguments in (
        ("hand", dict(table=read_evidence(lying, board))),
        ("touched", dict(touched=TOUCHED)),
    ):
        row: dict[str, object] = {
            "camera": number,
            "arm": arm.name,
            "method": method,
            "displaced_mm": 1e3 * float(np.linalg.norm(position - CAMERA.position)),
            "displaced_deg": _degrees(rotation, np.asarray(CAMERA.rotation)),
        }
        evidence = read_evidence(held if method == "hand" else touched, board)
        try:
            result = calibrate(evidence, board, now, **arguments)
        except CalibrationRefused as error:
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
    """Medians, maxima, and how often the claimed bound held, by arm and method."""
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


def main(arguments: list[str] | None = None) -> int:
    """Entry point; the last line printed is one JSON object."""
    parser = argparse.ArgumentParser(prog="calibration_trial", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for calibration.json, .png and _view.png")
    parser.add_argument("--cameras", type=int, default=10, help="how many (default %(default)s)")
    parser.add_argument("--views", type=int, default=16, help="postures of the hand (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the cameras (default %(default)s)")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    revision = origin()["revision"]
    progress, rows, calibration = Progress(options.cameras * len(ARMS), "cameras"), [], None
    with tempfile.TemporaryDirectory() as folder:
        for arm in ARMS:
            for number in range(options.cameras):
                found, kept = one(number, arm, options.seed, options.views, Path(folder))
                rows += found
                calibration = (kept, number) if kept is not None else calibration
                progress.show(len(rows) // 2)
    report = {
        "summary": summary(rows),
        "uncalibrated_keypoint_mean_px": float(
            np.median([row["uncalibrated"]["keypoint_mean_px"] for row in rows if "uncalibrated" in row])
        ),
        "uncalibrated_object_mean_mm": float(
            np.median([row["uncalibrated"]["object_mean_mm"] for row in rows if "uncalibrated" in row])
        ),
        "seed": options.seed,
        "revision": revision,
    }
    (options.out / "calibration.json").write_text(json.dumps({**report, "cameras": rows}, indent=1) + "\n")
    draw(rows, options.out / "calibration.png")
    if calibration is not None:
        picture(*calibration, options.seed, options.out / "calibration_view.png")
    print(json.dumps(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
