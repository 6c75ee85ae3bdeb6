"""From pictures to keypoints over real topics, without a camera."""

from datetime import UTC, datetime

import cv2
import numpy as np
import pytest
import yaml
from detector_weights import write_detector
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from np_common.rotations import matrix_from_vector, quaternion_from_matrix
from np_description.calibration import Calibration, CalibrationErrors, Lens
from np_description.camera import CAMERA
from np_description.domains import CARD
from np_description.message_arrays import camera_info_lens, image_array, keypoints_array, stamp_nanoseconds
from np_perception.camera.rectify import Rectifier
from np_perception.detector import IMAGE_SHAPE, KeypointDetector
from np_ros import qos

STAMPS = [3_000_000_000 + 40_000_000 * i for i in range(6)]


def write_pictures(folder, shape=IMAGE_SHAPE):
    folder.mkdir()
    images = [np.random.default_rng(i).integers(0, 256, shape, dtype=np.uint8) for i in range(len(STAMPS))]
    for stamp, image in zip(STAMPS, images):
        cv2.imwrite(str(folder / f"{stamp}.png"), image[..., ::-1])
    return images


def says(probe, node, level, text):
    return any(
        s.name.endswith(node) and s.level == level and text in s.message
        for a in probe.messages["diagnostics"]
        for s in a.status
    )


@pytest.fixture
def listening(probe):
    # In this order: who has found the second, for which the player waits, has found the first.
    probe.collect("camera/camera_info", CameraInfo)
    probe.collect("camera/image_raw", Image)
    probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
    return probe


def test_pictures_become_keypoints_with_their_own_stamps(graph, listening, tmp_path):
    write_detector(tmp_path / "weights")
    images = write_pictures(tmp_path / "pictures")
    keypoints = listening.collect("keypoints", PointCloud2)
    graph.run("np_perception", "keypoint_detector", {"weights": str(tmp_path / "weights"), "mode": "lockstep"})
    listening.wait_until_ready({"keypoint_detector"})  # or we might not hear its first answer
    graph.run(
        "np_perception",
        "camera_player",
        {"source": str(tmp_path / "pictures"), "stamps": "recorded", "mode": "lockstep", "subscribers": 2},
    )
    listening.wait_until(lambda: len(keypoints) == len(STAMPS), what="keypoints of every picture")
    assert [stamp_nanoseconds(m.header.stamp) for m in keypoints] == STAMPS
    detector = KeypointDetector(CARD, tmp_path / "weights")
    for message, image in zip(keypoints, images):
        expected = detector.detect(image).keypoints
        assert keypoints_array(message).astype(np.float32).tobytes() == expected.tobytes()
    listening.wait_until(
        lambda: says(listening, "camera_player", DiagnosticStatus.OK, "played the 6 images"),
        what="the end in diagnostics",
    )


def test_large_pictures_come_out_as_the_policies_see_them(graph, listening, tmp_path):
    lens = Lens(1280, 720, 920.0, 920.0, 640.0, 360.0, (0.1, -0.2, 0.0, 0.0, 0.0))
    images = write_pictures(tmp_path / "pictures", (720, 1280, 3))
    content = dict(fx=920.0, fy=920.0, cx=640.0, cy=360.0, distortion=list(lens.distortion))
    (tmp_path / "pictures" / "camera.yaml").write_text(yaml.safe_dump(content))
    rotation = np.asarray(CAMERA.rotation) @ matrix_from_vector(np.array([0.02, -0.01, 0.03]))
    calibration = Calibration(
        made=datetime.now(UTC),
        lens=lens,
        position=np.array([1.08, 0.01, 0.7]),
        quaternion=quaternion_from_matrix(rotation),
        covariance=1e-8 * np.eye(6),
        errors=CalibrationErrors(1e-4, 1e-4, 0.1, 0.1, 15, 300),
    )
    calibration.save(tmp_path / "camera.yaml")
    graph.run(
        "np_perception",
        "camera_player",
        {
            "source": str(tmp_path / "pictures"),
            "stamps": "recorded",
            "mode": "lockstep",
            "subscribers": 1,
            "calibration": str(tmp_path / "camera.yaml"),
        },
    )
    received, infos = listening.messages["camera/image_raw"], listening.messages["camera/camera_info"]
    listening.wait_until(lambda: len(received) == len(infos) == len(STAMPS), what="every picture")
    rectify = Rectifier(lens, calibration.camera, calibration.turn)
    for message, info, image, stamp in zip(received, infos, images, STAMPS):
        assert stamp_nanoseconds(message.header.stamp) == stamp_nanoseconds(info.header.stamp) == stamp
        np.testing.assert_array_equal(image_array(message), rectify(image))
        seen, turn = camera_info_lens(info)
        assert seen == Lens(224, 224, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
        np.testing.assert_allclose(turn, calibration.turn, atol=1e-12)


def test_a_picture_that_cannot_be_read_is_an_error_in_diagnostics(graph, listening, tmp_path):
    write_pictures(tmp_path / "pictures")
    (tmp_path / "pictures" / f"{STAMPS[3]}.png").write_bytes(b"cut off")
    graph.run("np_perception", "camera_player", {"source": str(tmp_path / "pictures"), "mode": "lockstep"})
    listening.wait_until(
        lambda: says(listening, "camera_player", DiagnosticStatus.ERROR, f"{STAMPS[3]}.png"),
        what="an error that names the picture",
    )
    listening.wait_until(lambda: len(listening.messages["camera/image_raw"]) == 3, what="those before it")
