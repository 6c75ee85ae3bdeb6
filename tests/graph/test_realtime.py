"""The whole graph in real time: an episode ends in a named phase, and the control loop can be measured."""

import json
import signal

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from graph_tools import TIMEOUT
from rclpy.duration import Duration
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


def test_an_episode_in_real_time(graph, probe, untrained, tmp_path):
    """A busy machine may make the backend stop for want of commands: that too is an end with a name."""
    phases = probe.collect("episode/phase", DiagnosticArray, qos.LATCHED)
    names = graph.run_card(
        {"episode": {"post_timeout": 1.0}}, mode="realtime", keypoints="truth", weights=str(untrained)
    )
    graph.run("np_bringup", "round_trip", {"out": str(tmp_path / "round_trip.json")})
    probe.wait_until_ready(names | {"round_trip"})
    assert probe.call("round_trip/start").success
    # While processes were starting, the controller may have been silent for long enough to be given up.
    probe.wait_until(lambda: probe.call("sim_bridge/reset").success or recover(probe), what="a reset")
    phases.clear()
    probe.wait_until(lambda: probe.call("episode/start").success, what="a start")
    probe.wait_until(lambda: phases and phase_state(phases[-1]).phase in ENDS, what="the end")
    assert phase_state(phases[0]).phase == "pre"
    assert graph.kill("round_trip", signal.SIGINT) == 0
    result = json.loads((tmp_path / "round_trip.json").read_text())
    assert result["periods"] > 100 and 0 < result["p50_ms"] <= result["p99_ms"] <= result["max_ms"]
    assert 0 <= result["missed"] <= 1 and result["keypoint_rate"] > 0


def test_frames_without_keypoints_are_counted(graph, probe, tmp_path):
    graph.run("np_bringup", "round_trip", {"out": str(tmp_path / "round_trip.json")})
    infos = probe.advertise("camera/camera_info", CameraInfo, qos.RECORDER)
    answers = probe.advertise("keypoints", PointCloud2, qos.RECORDER)
    probe.wait_until(lambda: probe.matched("camera/camera_info") and probe.matched("keypoints"))
    assert probe.call("round_trip/start").success
    for frame in range(53):
        stamp = 33_000_000 * frame
        infos.publish(camera_info_message(stamp, CAMERA_NAME, CAMERA))
        if frame % 10 != 5:
            answers.publish(keypoints_message(stamp, CAMERA_NAME, np.ones((8, 3))))
    for publisher in (infos, answers):
        assert publisher.wait_for_all_acked(Duration(seconds=TIMEOUT))
    assert graph.kill("round_trip", signal.SIGINT) == 0
    result = json.loads((tmp_path / "round_trip.json").read_text())
    assert result["frames"] == 50 and result["frames_dropped"] == 5
    assert 0 < result["frame_p50_ms"] <= result["frame_p99_ms"]
