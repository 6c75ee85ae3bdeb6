"""The oracle projects the true pose, under its stamp, with noise that a seed and a stamp name."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import PointCloud2
from sim2real.effects.patch import Patch, PatchEffect, dump_patch

from np_description.camera import CAMERA
from np_description.domains import CARD, sample_task
from np_description.keypoints import box_keypoints
from np_description.message_arrays import keypoints_array, stamp_nanoseconds
from np_description.panda import BASE_FRAME
from np_ros.messages import pose_message

STAMPS = (100_000_000, 134_000_000, 166_000_000)


def ask(probe, pose):
    """Keypoints (3, 8, 3) that the oracle gives for `pose` at three stamps."""
    received = probe.messages["keypoints"]
    received.clear()
    for stamp in STAMPS:
        probe.publish("object_pose", pose_message(stamp, BASE_FRAME, pose.position, pose.quaternion))
    probe.wait_until(lambda: len(received) == len(STAMPS), what="keypoints")
    assert [stamp_nanoseconds(m.header.stamp) for m in received] == list(STAMPS)
    return np.array([keypoints_array(m) for m in received])


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_keypoints_are_the_projected_truth(graph, probe, noise):
    probe.collect("keypoints", PointCloud2)
    probe.advertise("object_pose", PoseStamped)
    names = {graph.run("np_sim_bridge", "keypoint_oracle", {"noise": noise, "seed": 4})}
    probe.wait_until_ready(names)
    pose, _ = sample_task(CARD, np.random.default_rng(1))
    corners = box_keypoints(np.asarray(CARD.half_size), pose.position, pose.quaternion)
    truth = CAMERA.project(corners)[0]
    keypoints = ask(probe, pose)
    error = keypoints[:, :, :2] - truth
    assert (keypoints[:, :, 2] == 1).all()
    assert (ask(probe, pose) == keypoints).all()  # the same question has the same answer
    if noise == 0:
        assert np.abs(error).max() < 1e-4
    else:
        assert np.abs(error).max() > 0.5 and np.abs(error).max() < 6 * noise
        assert not np.allclose(error[0], error[1])  # other stamps, other draws
    refused = pose_message(200_000_000, "somewhere", pose.position, pose.quaternion)
    probe.publish("object_pose", refused)
    assert len(ask(probe, pose)) == len(STAMPS)  # refused, and the node goes on


def test_with_a_patch_it_sees_as_the_camera_that_is_wrong(graph, probe, tmp_path):
    """A camera that is moved and late: pixels of the camera where it truly is, of the pose before."""
    effects = (
        PatchEffect("camera_extrinsics", "camera", {"y": 0.01}),
        PatchEffect("camera_latency", "camera", {"delay": 0.034}),
    )
    (tmp_path / "patch.yaml").write_text(dump_patch(Patch(effects)))
    probe.collect("keypoints", PointCloud2)
    probe.advertise("object_pose", PoseStamped)
    names = {graph.run("np_sim_bridge", "keypoint_oracle", {"effects": str(tmp_path / "patch.yaml")})}
    probe.wait_until_ready(names)
    pose, _ = sample_task(CARD, np.random.default_rng(1))
    for number, stamp in enumerate(STAMPS[:2]):
        moved = pose.position + [0.0, 0.01 * number, 0.0]
        probe.publish("object_pose", pose_message(stamp, BASE_FRAME, moved, pose.quaternion))
    received = probe.messages["keypoints"]
    probe.wait_until(lambda: len(received) == 2, what="keypoints")
    seen = keypoints_array(received[1])[:, :2]
    corners = box_keypoints(np.asarray(CARD.half_size), pose.position - [0.0, 0.01, 0.0], pose.quaternion)
    assert np.abs(seen - CAMERA.project(corners)[0]).max() < 1e-3  # of the first pose
