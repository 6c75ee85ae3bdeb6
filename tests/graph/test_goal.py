"""The node `goal`: one task for a real robot."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState

from np_bringup.nodes.goal_node import goal_pose
from np_description.domains import BUMP, CARD, DOMAINS, WALL, is_success, pose_error, sample_task
from np_description.panda import BASE_FRAME, NOMINAL, STATE_NAMES
from np_description.rotations import yaw_quaternion
from np_ros import qos
from np_ros.messages import joint_state_message, pose_arrays, stamp_nanoseconds
from np_ros.supervisor import NodeDied


def test_the_goal_lies_on_the_table_on_the_backends_clock_and_is_latched(graph, probe):
    graph.run("np_bringup", "goal", {"x": 0.45, "y": 0.1, "yaw": 0.5})
    probe.advertise("joint_states", JointState)
    probe.wait_until(lambda: probe.matched("joint_states"), what="the node")
    goals = probe.collect("goal_pose", PoseStamped, qos.LATCHED)

    def send_state(stamp):
        probe.publish(
            "joint_states", joint_state_message(stamp, STATE_NAMES, [*NOMINAL.ready, 0, 0], np.zeros(9), np.zeros(9))
        )

    # A best-effort subscriber that we know of may not know of us yet, and miss the first.
    probe.wait_until(lambda: goals or send_state(7_000_000), what="the goal")
    send_state(9_000_000)
    late = probe.collect("goal_pose", PoseStamped, qos.LATCHED)
    probe.wait_until(lambda: late, what="the goal, for who comes later")
    position, quaternion = pose_arrays(goals[0], BASE_FRAME)
    np.testing.assert_allclose(position, [0.45, 0.1, CARD.half_size[2]])
    np.testing.assert_allclose(quaternion, yaw_quaternion(np.asarray(0.5)))
    assert {stamp_nanoseconds(goal.header.stamp) for goal in (*goals, *late)} == {7_000_000}


def test_a_goal_that_nobody_was_trained_for_is_refused(graph, probe):
    graph.run("np_bringup", "goal", {"x": 0.9})
    with pytest.raises(NodeDied, match="expected one of card's goals"):
        probe.wait_until(lambda: False)


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=list(DOMAINS))
def test_every_goal_that_is_drawn_can_be_asked_for(domain):
    """By x, y, yaw and the quarter turns before it, some combination of which gives the very pose."""
    rng = np.random.default_rng(0)
    for _ in range(30):
        _, goal = sample_task(domain, rng)
        turns = range(4) if domain is BUMP else range(1)
        tried = [
            goal_pose(domain, *goal.position[:2], yaw, roll, pitch)
            for roll in turns
            for pitch in turns
            for yaw in (np.linspace(-np.pi, np.pi, 73) if domain is not WALL else [0.0])
        ]
        errors = [pose_error(p.position, p.quaternion, goal.position, goal.quaternion) for p in tried]
        assert min(distance for distance, _ in errors) < 1e-9
        assert any(is_success(domain, *error) for error in errors)


@pytest.mark.parametrize(
    "domain, arguments, text",
    [
        (CARD, (0.9, 0.0, 0.0), "goals .*got x 0.9"),
        (WALL, (0.62, -0.1, 0.0), "one of wall's goals"),
        (WALL, (0.62, 0.1, 1.0), "yaw 1.00"),
        (BUMP, (0.5, 0.07, 0.0), "one of bump's goals"),
        (CARD, (0.5, 0.0, 0.0, 1, 0), "no roll_turns and pitch_turns for card"),
    ],
)
def test_what_a_goal_cannot_be_is_named(domain, arguments, text):
    with pytest.raises(ValueError, match=text):
        goal_pose(domain, *arguments)
