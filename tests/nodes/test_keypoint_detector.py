"""The keypoint_detector node."""

from dataclasses import replace

import numpy as np
import pytest
from detector_weights import write_detector
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_tools import refusal
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from np_description.camera import CAMERA
from np_description.domains import CARD
from np_description.message_arrays import keypoints_array, stamp_nanoseconds
from np_perception.detector import IMAGE_SHAPE, KeypointDetector
from np_perception.nodes import keypoint_detector_node
from np_ros import qos
from np_ros.messages import camera_info_message, image_message

TOPIC = "camera/image_raw"


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A detector whose scores are high."""
    folder = tmp_path_factory.mktemp("weights")
    write_detector(folder)
    return folder


def random_image(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, IMAGE_SHAPE, dtype=np.uint8)


def start(graph, probe, folder, **parameters) -> None:
    probe.collect("keypoints", PointCloud2)
    probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
    probe.advertise(TOPIC, Image)
    graph.run("np_perception", "keypoint_detector", {"weights": str(folder), **parameters})
    probe.wait_until_ready({"keypoint_detector"})  # both ways: or we might not hear its first answer


def warning(probe, text: str) -> bool:
    statuses = [s for array in probe.messages["diagnostics"] for s in array.status]
    return any(s.level == DiagnosticStatus.WARN and text in s.message for s in statuses)


def test_every_image_is_answered_in_lockstep_with_its_own_stamp(graph, probe, weights):
    start(graph, probe, weights, mode="lockstep")
    stamps = [1_000_000_000 + 33_333_333 * i for i in range(10)]
    for i, stamp in enumerate(stamps):
        probe.publish(TOPIC, image_message(stamp, "camera", random_image(i)))
    probe.wait_until(lambda: len(probe.messages["keypoints"]) == len(stamps), what="ten answers")
    answers = probe.messages["keypoints"]
    assert [stamp_nanoseconds(a.header.stamp) for a in answers] == stamps
    assert {a.header.frame_id for a in answers} == {"camera"}
    detector = KeypointDetector(CARD, weights)
    for i, answer in enumerate(answers):
        assert (
            keypoints_array(answer).astype(np.float32).tobytes() == detector.detect(random_image(i)).keypoints.tobytes()
        )


def test_refused_images_are_reported_and_the_node_goes_on(graph, probe, weights):
    start(graph, probe, weights, mode="lockstep")
    wrong = image_message(1, "camera", random_image(0))
    wrong.encoding = "mono16"
    probe.publish(TOPIC, wrong)
    probe.publish(TOPIC, image_message(2, "camera", np.zeros((100, 224, 3), np.uint8)))
    probe.publish(TOPIC, image_message(3, "camera", random_image(0)))
    probe.wait_until(lambda: probe.messages["keypoints"], what="the answer to the good image")
    assert [stamp_nanoseconds(m.header.stamp) for m in probe.messages["keypoints"]] == [3]

    def counted(kind: str) -> bool:
        pairs = {(v.key, v.value) for a in probe.messages["diagnostics"] for s in a.status for v in s.values}
        return (f"refused images: {kind}", "1") in pairs

    probe.wait_until(lambda: counted("encoding") and counted("shape"), what="both refusals in diagnostics")
    probe.wait_until(lambda: warning(probe, "refused images"), what="a warning")


def test_a_silent_camera_is_a_warning_in_real_time_and_ends_with_the_next_image(graph, probe, weights):
    start(graph, probe, weights, mode="realtime", image_timeout=0.3)
    probe.wait_until(lambda: warning(probe, "no image on camera/image_raw"), what="a warning")
    probe.messages["diagnostics"].clear()

    # The subscription is best effort: repeat until one image has come through.
    def answered() -> bool:
        probe.publish(TOPIC, image_message(5, "camera", random_image(0)))
        return bool(probe.messages["keypoints"])

    probe.wait_until(answered, what="an answer")
    probe.wait_until(
        lambda: any(s.level == DiagnosticStatus.OK for a in probe.messages["diagnostics"] for s in a.status),
        what="the end of the warning",
    )


@pytest.mark.slow
def test_collapsed_scores_are_a_warning(graph, probe, tmp_path):
    write_detector(tmp_path, score=-4.0)
    start(graph, probe, tmp_path, mode="lockstep")
    for i in range(20):
        probe.publish(TOPIC, image_message(i, "camera", random_image(i)))
    probe.wait_until(lambda: warning(probe, "fewer than 4 keypoints"), what="a warning")


def test_missing_weights_end_the_node_with_one_clear_line(capfd, tmp_path):
    said = refusal(capfd, keypoint_detector_node.main, weights=tmp_path)
    assert "cannot start: keypoint detector: expected the network" in said


def test_the_first_image_of_another_camera_is_refused_too(graph, probe, weights):
    """Its camera_info came before it, and both wait while the node is busy."""
    start(graph, probe, weights, mode="lockstep")
    probe.advertise("camera/camera_info", CameraInfo)
    probe.wait_until(lambda: probe.matched("camera/camera_info"), what="the detector")
    with graph.frozen("keypoint_detector"):
        other = replace(CAMERA, fx=CAMERA.fx + 20)
        probe.publish("camera/camera_info", camera_info_message(1, "camera", other))
        probe.publish(TOPIC, image_message(1, "camera", random_image(1)))
    probe.wait_until(lambda: warning(probe, "refused images: camera") or probe.messages["keypoints"], what="an answer")
    assert not probe.messages["keypoints"]


def test_images_of_another_camera_are_refused_until_they_are_of_the_one_of_training(graph, probe, weights):
    start(graph, probe, weights, mode="lockstep")
    probe.advertise("camera/camera_info", CameraInfo)
    probe.wait_until(lambda: probe.matched("camera/camera_info"), what="the detector")
    stamp = 0

    def show(camera):
        nonlocal stamp
        stamp += 1
        probe.publish("camera/camera_info", camera_info_message(stamp, "camera", camera))
        probe.publish(TOPIC, image_message(stamp, "camera", random_image(stamp)))

    def refused():
        show(replace(CAMERA, fx=CAMERA.fx + 20))
        return any(
            pair.key == "refused images: camera"
            for array in probe.messages["diagnostics"]
            for status in array.status
            for pair in status.values
        )

    probe.wait_until(refused, what="refused images in diagnostics")
    answered = len(probe.messages["keypoints"])

    def seen():
        show(CAMERA)
        return len(probe.messages["keypoints"]) > answered

    probe.wait_until(seen, what="keypoints")
