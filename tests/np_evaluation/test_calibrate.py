"""The command `calibrate` on recordings of a rendered board, and what it refuses."""

import json
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message

from np_common.rotations import matrix_from_vector, vector_from_matrix
from np_description.calibration import Lens, load
from np_description.camera import CAMERA
from np_description.panda import NOMINAL, STATE_NAMES
from np_evaluation.calibration_trial.board_recording import record_rests
from np_evaluation.calibration_trial.board_scene import BoardScene, hand_mount, table_mount
from np_evaluation.calibration_trial.trial import card_errors, true_view
from np_perception.calibration.board import Board, BoardDetection, BoardError
from np_perception.calibration.evidence import (
    RESTING,
    CalibrationRefusal,
    average_detections,
    find_still_postures,
    read_calibration_data,
)
from np_perception.calibration.fitting import calibrate, keypoint_bound
from np_perception.calibration.printing import page
from np_perception.commands.calibrate import main
from np_perception.commands.calibration_board import main as print_board
from np_record.bag_writer import BagWriter
from np_record.topics import BY_NAME
from np_ros.messages import camera_info_message, image_message, joint_state_message

BOARD = Board()
POSITION = np.asarray(CAMERA.position) + [0.02, -0.015, 0.01]
ROTATION = np.asarray(CAMERA.rotation) @ matrix_from_vector(np.array([0.02, -0.03, 0.015]))
NOW = datetime(2026, 1, 2, tzinfo=UTC)


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A recording of a board in the hand: ten postures."""
    with closing(BoardScene(BOARD, hand_mount(BOARD), POSITION, ROTATION)) as scene:
        postures = scene.postures(10, np.random.default_rng(1))
        return record_rests(tmp_path_factory.mktemp("bags") / "hand", scene, postures)


@pytest.fixture(scope="module")
def lying(tmp_path_factory):
    """A recording of the board on the table."""
    with closing(BoardScene(BOARD, table_mount(BOARD, height=0.002), POSITION, ROTATION, in_hand=False)) as scene:
        return record_rests(tmp_path_factory.mktemp("bags") / "table", scene, [NOMINAL.ready])


def run(capsys, *arguments) -> tuple[int, dict]:
    status = main([str(a) for a in arguments])
    return status, json.loads(capsys.readouterr().out.strip().splitlines()[-1])


def test_the_camera_is_found_within_what_is_claimed(held, lying, tmp_path, capsys):
    out = tmp_path / "camera.yaml"
    status, said = run(capsys, held, "--table", lying, "--out", out)
    assert status == 0 and said["complaints"] == [] and said["views"] >= 9
    found = load(out)
    assert np.linalg.norm(found.position - POSITION) <= found.errors.position_95 < 0.001
    assert np.linalg.norm(vector_from_matrix(found.rotation @ ROTATION.T)) <= found.errors.rotation_95 < 0.001
    assert found.age() < timedelta(minutes=10)
    seen = card_errors(true_view(found, POSITION, ROTATION), found.camera)
    assert seen["keypoint_max_px"] <= found.errors.keypoint_95 < 0.2
    assert abs(found.table.height - 0.002) <= found.table.height_95 < 0.003
    assert np.linalg.norm(found.table.tilt) <= found.table.tilt_95 < 0.03


def test_what_upstream_has_turned_is_turned_back(held):
    """Images that were rectified by a rotation already give the same camera."""
    evidence = read_calibration_data(held, BOARD)
    plain = calibrate(evidence, BOARD, NOW).calibration
    turn = matrix_from_vector(np.array([0.01, 0.02, -0.03]))
    lens = evidence.lens

    def turned(detection):
        rays = (
            np.column_stack([(detection.pixels - (lens.cx, lens.cy)) / lens.fx, np.ones(len(detection.pixels))])
            @ turn.T
        )
        return BoardDetection(
            detection.ids, rays[:, :2] / rays[:, 2:] * lens.fx + (lens.cx, lens.cy), detection.markers
        )

    other = replace(evidence, turn=turn, detections=[(i, turned(d)) for i, d in evidence.detections])
    again = calibrate(other, BOARD, NOW).calibration
    np.testing.assert_allclose(again.position, plain.position, atol=1e-4)
    np.testing.assert_allclose(again.rotation, plain.rotation, atol=1e-4)


@pytest.mark.parametrize(
    "options, words",
    [
        (["--dictionary", "DICT_6X6_50"], "with 17 markers of DICT_6X6_50, it was not found"),
        (["--dictionary", "DICT_9X9"], "one of OpenCV's dictionaries"),
        (["--marker", "0.05"], "markers smaller than squares"),
        (["--touched", "0,1,2"], "rest once on each of the 3 corners named, it rested 10 times"),
    ],
)
def test_another_board_is_refused_and_no_file_is_written(held, tmp_path, capsys, options, words):
    out = tmp_path / "camera.yaml"
    status, said = run(capsys, held, "--out", out, *options)
    assert status == 1 and words in said["error"] and not out.exists()


def test_a_board_that_is_not_printed_to_scale_is_refused_unless_accepted(held, tmp_path, capsys):
    out = tmp_path / "camera.yaml"
    arguments = (held, "--out", out, "--square", "0.0375", "--marker", "0.0281")
    status, said = run(capsys, *arguments)
    assert status == 1 and "printed to scale" in said["error"] and not out.exists()
    status, said = run(capsys, *arguments, "--accept")
    assert status == 0 and said["board_scale"][0] == pytest.approx(0.96, abs=0.005) and out.exists()


def test_too_few_views_are_refused(held):
    evidence = read_calibration_data(held, BOARD)
    few = replace(evidence, rests=evidence.rests[:5], detections=[d for d in evidence.detections if d[0] < 5], images=5)
    with pytest.raises(CalibrationRefusal, match=r"at least 8 views, got . \(5 postures at rest"):
        calibrate(few, BOARD, NOW)


def test_a_cut_off_bag_is_refused_by_name(held, tmp_path, capsys):
    bag = tmp_path / "bag"
    bag.mkdir()
    for file in held.iterdir():
        (bag / file.name).write_bytes(file.read_bytes()[:-3000] if file.suffix == ".mcap" else file.read_bytes())
    status, said = run(capsys, bag, "--out", tmp_path / "camera.yaml")
    assert status == 1 and str(bag) in said["error"] and "cut off" in said["error"]


@pytest.mark.parametrize(
    "joint, speed, image, words",
    [
        (np.nan, 0.0, 400, "expected finite numbers"),
        (0.0, 0.5, 400, "the arm to rest for 0.8 s at every posture, it never did"),
        (0.0, 0.0, 300, "expected images of 400 x 400 as in camera_info, got 300 x 300"),
        (0.0, 0.0, 400, "0 of its markers were seen in 2 images"),
    ],
)
def test_recordings_that_show_nothing_are_refused(tmp_path, capsys, joint, speed, image, words):
    writer = BagWriter(tmp_path / "bag", {})
    for i in range(100):
        stamp, joints = 20_000_000 * i, np.full(9, joint)
        messages = [("joint_states", joint_state_message(stamp, STATE_NAMES, joints, np.full(9, speed), np.zeros(9)))]
        if i in (50, 90):
            camera = type(CAMERA)(400, 400, 741.0, 741.0, 199.5, 199.5, CAMERA.position, CAMERA.rotation)
            messages += [
                ("camera/camera_info", camera_info_message(stamp, "camera", camera)),
                (
                    "camera/image_raw",
                    image_message(stamp, "camera", np.full((image, image, 3), 128, np.uint8)),
                ),
            ]
        for name, message in messages:
            writer.write(stamp, BY_NAME[name], serialize_message(message))
    writer.close()
    status, said = run(capsys, tmp_path / "bag", "--out", tmp_path / "camera.yaml")
    assert status == 1 and words in said["error"]


@settings(max_examples=20)
@given(st.lists(st.tuples(st.integers(40, 90), st.integers(3, 20)), min_size=1, max_size=6), st.integers(0, 1000))
def test_every_rest_is_found(plan, seed):
    """Rests of 0.8 s or more between movements, joint states every 20 ms."""
    rng = np.random.default_rng(seed)
    positions, velocities, expected, q = [], [], [], rng.normal(0, 1, 7)
    for rest, way in plan:
        expected.append(q.copy())
        positions += [q + rng.normal(0, 1e-5, 7) for _ in range(rest + 1)]
        velocities += [rng.normal(0, RESTING / 10, 7) for _ in range(rest + 1)]
        step = rng.choice([-1, 1], 7) * 0.1
        positions += [q + step * (k + 1) for k in range(way)]
        velocities += [step / 0.02] * way
        q = q + step * way
    stamps = 20_000_000 * np.arange(len(positions))
    rests = find_still_postures(stamps, np.array(positions), np.array(velocities))
    assert len(rests) == len(expected)
    for rest, joints in zip(rests, expected):
        np.testing.assert_allclose(rest.joints, joints, atol=1e-4)


def test_corners_on_which_images_disagree_are_left_out():
    ids = np.arange(10)
    still, moving = np.random.default_rng(0).uniform(0, 400, (10, 2)), np.zeros((10, 2))
    moving[3] = 2.0
    points, pixels = average_detections(
        [BoardDetection(ids, still + k * moving, ids) for k in range(3)],
        BOARD,
        Lens(400, 400, 741.0, 741.0, 199.5, 199.5),
    )
    assert len(points) == 9 and not (pixels == still[3]).all(axis=1).any()


def test_the_bound_on_keypoints_is_that_of_the_projection():
    """A shift of 1 mm (standard deviation) along the image's rows moves a point at 0.9 m by f/0.9 mm = 0.46
    px."""
    right = np.asarray(CAMERA.rotation)[:, 0]
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = 1e-6 * np.outer(right, right)
    nearest = 0.78  # m, depth of the corner of the workspace that is nearest to the camera
    assert keypoint_bound(covariance, np.inf) == pytest.approx(1.96 * 1e-3 * CAMERA.fx / nearest, rel=0.08)


def test_the_printed_board_is_the_one_that_is_looked_for(tmp_path, capsys):
    out = tmp_path / "board.png"
    assert print_board(["--out", str(out)]) == 0
    from PIL import Image

    with Image.open(out) as picture:
        assert picture.info["dpi"] == pytest.approx((600, 600), abs=0.1)
        assert picture.size == (7016, 4961)  # A4
    small = np.repeat(page(BOARD, dpi=150)[..., None], 3, axis=2)
    found = BOARD.detect(small)
    assert len(found.ids) == len(BOARD.corners)
    spacing = found.pixels[1] - found.pixels[0]
    np.testing.assert_allclose(spacing, [BOARD.square / 0.0254 * 150, 0], atol=0.5)  # squares are whole dots
    with pytest.raises(BoardError, match="fits on A4"):
        page(Board(columns=9))
