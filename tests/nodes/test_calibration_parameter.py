"""`calibration:=<file>` reaches everyone who projects, and a file that is none stops them."""

import importlib
from datetime import UTC, datetime

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from graph_tools import refusal
from sensor_msgs.msg import PointCloud2

from np_bringup.task_graph import task_graph
from np_common.rotations import matrix_from_vector, quaternion_from_matrix
from np_description.calibration import Calibration, CalibrationErrors, Lens
from np_description.camera import CAMERA
from np_description.domains import CARD, sample_task
from np_description.keypoints import box_keypoints
from np_description.message_arrays import keypoints_array
from np_description.panda import BASE_FRAME
from np_description.scene import CAMERA_NAME
from np_perception.pose_estimation import project_keypoints
from np_policy.episode import Episode, Goal
from np_policy.episode_config import EpisodeConfig
from np_ros.messages import pose_message
from np_sim_bridge.simulation import Simulation


@pytest.fixture
def calibration(tmp_path):
    rotation = np.asarray(CAMERA.rotation) @ matrix_from_vector(np.array([0.02, -0.01, 0.03]))
    made = Calibration(
        made=datetime.now(UTC),
        lens=Lens(400, 400, 741.0, 741.0, 199.5, 199.5),
        position=np.array([1.07, 0.02, 0.70]),
        quaternion=quaternion_from_matrix(rotation),
        covariance=1e-8 * np.eye(6),
        errors=CalibrationErrors(1e-4, 1e-4, 0.1, 0.1, 15, 300),
    )
    made.save(tmp_path / "camera.yaml")
    return made


def test_the_oracle_projects_from_where_the_camera_is(graph, probe, calibration, tmp_path):
    received = probe.collect("keypoints", PointCloud2)
    probe.advertise("object_pose", PoseStamped)
    probe.wait_until_ready(
        {graph.run("np_sim_bridge", "keypoint_oracle", {"calibration": str(tmp_path / "camera.yaml")})}
    )
    pose, _ = sample_task(CARD, np.random.default_rng(1))
    probe.publish("object_pose", pose_message(100_000_000, BASE_FRAME, pose.position, pose.quaternion))
    probe.wait_until(lambda: received, what="keypoints")
    corners = box_keypoints(np.asarray(CARD.half_size), pose.position, pose.quaternion)
    seen = keypoints_array(received[0])[:, :2]
    np.testing.assert_allclose(seen, calibration.camera.project(corners)[0], atol=1e-4)
    assert np.abs(seen - CAMERA.project(corners)[0]).max() > 3


def test_the_bridges_camera_stands_there(calibration):
    model = Simulation(CARD, camera=calibration.camera).model
    np.testing.assert_allclose(model.camera(CAMERA_NAME).pos, calibration.position)


def test_goals_are_projected_from_there(calibration):
    pose, _ = sample_task(CARD, np.random.default_rng(2))
    events = Episode(EpisodeConfig(CARD, camera=calibration.camera)).goal(0, pose)
    (goal,) = (event for event in events if isinstance(event, Goal))
    np.testing.assert_array_equal(goal.keypoints, project_keypoints(CARD, pose, calibration.camera))


@pytest.mark.parametrize("keypoints", ["camera", "truth"])
def test_the_launch_argument_reaches_everyone_who_projects(keypoints):
    nodes = task_graph({"calibration": "camera.yaml", "keypoints": keypoints})
    given = {node.name for node in nodes if node.parameters.get("calibration") == "camera.yaml"}
    expected = {"sim_bridge", "pre_contact", "approach", "post_contact", "episode"}
    assert given == expected | ({"keypoint_oracle"} if keypoints == "truth" else set())


@pytest.mark.parametrize(
    "module",
    [
        "np_policy.nodes.episode_node",
        "np_perception.nodes.camera_player_node",
        "np_sim_bridge.nodes.sim_bridge_node",
    ],
)
def test_a_file_that_is_none_stops_the_node_with_one_line(module, capfd, tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text("position: [1, 2")
    said = refusal(capfd, importlib.import_module(module).main, calibration=path)
    assert f"cannot start: calibration {path}: expected a file written by `calibrate`" in said
