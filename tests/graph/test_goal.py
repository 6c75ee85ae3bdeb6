"""The node `goal`: one task for a real robot."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from np_bringup.supervisor import NodeDied
from np_description.domains import CARD
from np_description.panda import BASE_FRAME, NOMINAL, STATE_NAMES
from np_description.rotations import yaw_quaternion
from np_ros import qos
from np_ros.messages import joint_state_message, pose_arrays, stamp_nanoseconds
from sensor_msgs.msg import JointState


def test_the_goal_lies_on_the_table_on_the_backends_clock_and_is_latched(graph, probe):
    graph.run("np_bringup", "goal", {"x": 0.45, "y": 0.1, "yaw": 0.5})
    probe.advertise("joint_states", JointState)
    probe.wait_until(lambda: probe.matched("joint_states"), what="the node")
    goals = probe.collect("goal_pose", PoseStamped, qos.LATCHED)

    def send_state(stamp):
        probe.publish("joint_states", joint_state_message(
            stamp, STATE_NAMES, [*NOMINAL.ready, 0, 0], np.zeros(9), np.zeros(9)))

    # A best-effort subscriber that we know of may not know of us yet, and miss the first.
    probe.wait_until(lambda: goals or send_state(7_000_000), what="the goal")
    send_state(9_000_000)
    late = probe.collect("goal_pose", PoseStamped, qos.LATCHED)
    probe.wait_until(lambda: late, what="the goal, for who comes later")
    position, quaternion = pose_arrays(goals[0], BASE_FRAME)
    np.testing.assert_allclose(position, [0.45, 0.1, CARD.half_size[2]])
    np.testing.assert_allclose(quaternion, yaw_quaternion(np.asarray(0.5)))
    assert {stamp_nanoseconds(goal.header.stamp) for goal in (*goals, *late)} == {7_000_000}


def test_a_goal_outside_the_workspace_is_refused(graph, probe):
    graph.run("np_bringup", "goal", {"x": 0.9})
    with pytest.raises(NodeDied, match="workspace of card"):
        probe.wait_until(lambda: False)
