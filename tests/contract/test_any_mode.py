"""What every backend keeps in every mode: topics, states, refusals, watchdog, stop, recover."""

import math
import signal

import numpy as np
from backends import PERIOD, silent
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from np_control.safety import LIMITS
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_ros.messages import joint_state_arrays, stamp_nanoseconds

PUBLISHED = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/applied_command": "sensor_msgs/msg/JointState",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
TASK_TOPICS = {
    "/goal_pose": "geometry_msgs/msg/PoseStamped",
    "/object_pose": "geometry_msgs/msg/PoseStamped",
    "/clock": "rosgraph_msgs/msg/Clock",
}
CAMERA_TOPICS = {"/camera/image_raw": "sensor_msgs/msg/Image", "/camera/camera_info": "sensor_msgs/msg/CameraInfo"}
SUBSCRIBED = {"/gripper_command": "std_msgs/msg/Float64"}


def test_topics_and_types(any_start):
    harness = any_start()
    backend, node = harness.backend, harness.probe.node
    expected = dict(PUBLISHED)
    expected |= TASK_TOPICS if backend.has_tasks else {}
    expected |= CAMERA_TOPICS if backend.has_camera else {}
    expected |= backend.commands.published
    subscribed = SUBSCRIBED | backend.commands.subscribed

    def has(list_topics, topics):
        return topics.items() <= {topic: names[0] for topic, names in list_topics(backend.name, "/")}.items()

    harness.wait(lambda: backend.name in node.get_node_names(), "the node to be known")
    harness.wait(lambda: has(node.get_publisher_names_and_types_by_node, expected), "its publishers")
    harness.wait(lambda: has(node.get_subscriber_names_and_types_by_node, subscribed), "its subscriptions")


def test_states_are_whole_and_stamps_increase(any_start):
    harness = any_start()
    harness.follow(harness.commands.stay, lambda: len(harness.states) > 100, "100 states")
    stamps = [stamp_nanoseconds(state.header.stamp) for state in harness.states]
    # A state may be published twice while time stands still; time itself never goes back.
    assert all(later >= earlier and later % PERIOD == 0 for earlier, later in zip(stamps, stamps[1:]))
    for state in harness.states:
        position, velocity, effort = joint_state_arrays(state, STATE_NAMES)
        assert (LIMITS.position_lower <= position[:7]).all() and (position[:7] <= LIMITS.position_upper).all()
        assert (np.abs(effort[:7]) <= LIMITS.torque).all()


def test_an_accepted_command_moves_the_arm_and_is_reported(any_start):
    harness = any_start()
    applied = harness.probe.collect("applied_command", JointState)
    harness.wait(lambda: harness.probe.publishers("applied_command"), "applied_command")
    first = harness.states[-1].position[6]
    harness.follow(harness.commands.turn, lambda: harness.states[-1].position[6] > first + 0.02, "joint 7 to turn")
    harness.follow(harness.commands.turn, lambda: any(m.effort[6] > 1.0 for m in applied), "applied_command to tell")
    for message in applied:
        joint_state_arrays(message, JOINT_NAMES)
        assert stamp_nanoseconds(message.header.stamp) % (5 * PERIOD) == 0


def test_bad_commands_are_refused_counted_and_not_applied(any_start):
    harness = any_start()
    applied = harness.probe.collect("applied_command", JointState)
    for reason, make in harness.commands.bad.items():
        harness.send_until_refused(make, reason)
        harness.resume()
    for message in applied:
        _, _, effort = joint_state_arrays(message, JOINT_NAMES)
        assert (np.abs(effort) < 5.0).all()  # holding the posture takes next to nothing
    harness.follow(harness.commands.stay, lambda: harness.status.get("state") == "moving", "a good command to be taken")


def test_a_late_command_is_refused(any_start):
    harness = any_start()
    old = harness.commands.stay(harness.states[0])
    late = stamp_nanoseconds(harness.states[0].header.stamp) + 10 * PERIOD
    harness.follow(harness.commands.stay, lambda: harness.stamp > late, "time to pass")
    before = harness.refused("late") + harness.refused("order")
    harness.send(old)
    harness.wait(lambda: harness.refused("late") + harness.refused("order") > before, "the refusal")


def test_a_bad_gripper_command_is_refused(any_start):
    harness = any_start()
    harness.probe.advertise("gripper_command", Float64)
    harness.wait(lambda: harness.probe.matched("gripper_command"), "gripper_command")
    for count, opening in enumerate((math.nan, -0.01, 0.05), start=1):
        harness.probe.publish("gripper_command", Float64(data=opening))
        harness.wait(lambda: harness.refused("gripper") == count, f"refusal of {opening}")


def test_fingers_follow_the_gripper_command(any_start):
    harness = any_start()
    harness.probe.advertise("gripper_command", Float64)
    harness.wait(lambda: harness.probe.matched("gripper_command"), "gripper_command")
    harness.probe.publish("gripper_command", Float64(data=0.02))
    harness.follow(
        harness.commands.stay, lambda: np.allclose(harness.states[-1].position[7:], 0.02, atol=1e-3), "the fingers"
    )


def test_stop_wins_over_commands_until_recover(any_start):
    harness = any_start()
    first = harness.states[-1].position[6]
    harness.follow(harness.commands.turn, lambda: harness.states[-1].position[6] > first + 0.02, "joint 7 to turn")
    harness.answer = harness.commands.turn
    assert harness.call("stop").success
    harness.wait_state("stopped")
    harness.wait(lambda: max(map(abs, harness.states[-1].velocity[:7])) < LIMITS.rest_speed, "rest")
    refused = harness.refused("state")
    harness.send(harness.commands.turn(harness.states[-1]))
    harness.wait(lambda: harness.refused("state") > refused, "the refusal of a command after stop")
    assert harness.status["state"] == "stopped"
    harness.answer = silent
    if harness.backend.has_tasks:
        response = harness.call("reset")
        assert not response.success and "recover" in response.message
    assert harness.call("recover").success
    harness.wait_state("ready")
    harness.follow(harness.commands.stay, lambda: harness.status.get("state") == "moving", "commands to be taken again")


def test_recover_without_a_stop_is_refused(any_start):
    harness = any_start()
    response = harness.call("recover")
    assert not response.success and "nothing to recover" in response.message


def test_the_backend_ends_cleanly(any_start):
    harness = any_start()
    harness.follow(harness.commands.stay, lambda: len(harness.states) > 20, "20 states")
    assert harness.graph.kill(harness.backend.name, signal.SIGINT) == 0
