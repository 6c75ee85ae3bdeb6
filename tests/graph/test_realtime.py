"""The whole graph in real time: an episode ends in a named phase, and the control loop can be measured."""

import json
import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph_tools import reset
from sensor_msgs.msg import CameraInfo, PointCloud2

from np_description.camera import CAMERA
from np_description.phases import ENDS
from np_description.scene import CAMERA_NAME
from np_ros import qos
from np_ros.messages import camera_info_message, keypoints_message
from np_ros.phases import phase_state


def recover(probe):
    """Ask the backend to recover; False, so that the reset is tried again."""
    probe.call("sim_bridge/recover")
    return False


@pytest.mark.real_time
@pytest.mark.slow  # test_quickstart.py plays an episode in real time too
def test_an_episode_in_real_time(graph, probe, untrained, tmp_path):
    """A busy machine may make the backend stop for want of commands: that too is an end with a name."""
    phases = probe.collect("episode/phase", DiagnosticArray, qos.RECORDER_LATCHED)
    names = graph.run_card(
        {"episode": {"post_timeout": 1.0}}, mode="realtime", keypoints="truth", weights=str(untrained)
    )
    graph.run(
        "np_evaluation", "np_evaluation.bench.round_trip", {"out": str(tmp_path / "round_trip.json")}, name="round_trip"
    )
    probe.wait_until_ready(names | {"round_trip"})
    assert probe.call("round_trip/start").success
    # While processes were starting, the controller may have been silent for long enough to be given up.
    probe.wait_until(lambda: reset(probe) or recover(probe), what="a reset")
    phases.clear()
    probe.wait_until(lambda: probe.call("episode/start").success, what="a start")

    def has_ended():
        said = [phase_state(message).phase for message in phases]  # the end of a fault of before may come first
        return "pre" in said and any(phase in ENDS for phase in said[said.index("pre") :])

    probe.wait_until(has_ended, what="the end")
    assert graph.kill("round_trip", signal.SIGINT) == 0
    result = json.loads((tmp_path / "round_trip.json").read_text())
    assert result["periods"] > 100 and 0 < result["p50_ms"] <= result["p99_ms"] <= result["max_ms"]
    assert 0 <= result["missed"] <= 1 and result["keypoint_rate"] > 0


def test_frames_without_keypoints_are_counted(graph, probe, tmp_path):
    graph.run(
        "np_evaluation", "np_evaluation.bench.round_trip", {"out": str(tmp_path / "round_trip.json")}, name="round_trip"
    )
    infos = probe.advertise("camera/camera_info", CameraInfo, qos.RECORDER)
    answers = probe.advertise("keypoints", PointCloud2, qos.RECORDER)
    probe.wait_until(lambda: probe.matched("camera/camera_info") and probe.matched("keypoints"))
    assert probe.call("round_trip/start").success
    for frame in range(53):
        stamp = 33_000_000 * frame
        infos.publish(camera_info_message(stamp, CAMERA_NAME, CAMERA))
        if frame % 10 != 5:
            answers.publish(keypoints_message(stamp, CAMERA_NAME, np.ones((8, 3))))
    said = probe.collect("diagnostics", DiagnosticArray, qos.EVENT)

    def heard():
        values = {(pair.key, pair.value) for array in said for status in array.status for pair in status.values}
        return {("frames", "53"), ("keypoints", "48")} <= values

    probe.wait_until(heard, what="all of it to be heard")
    assert graph.kill("round_trip", signal.SIGINT) == 0
    result = json.loads((tmp_path / "round_trip.json").read_text())
    assert result["frames"] == 50 and result["frames_dropped"] == 5
    assert 0 < result["frame_p50_ms"] <= result["frame_p99_ms"]
