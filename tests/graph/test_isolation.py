"""Nothing in the policy path subscribes to `object_pose`, nor to anything else that docs/reference/graph.md does not give it."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from graph_tools import Graph, card_specs, reset
from random_weights import write_weights

from np_ros import qos
from np_ros.phases import phase_state

LEADING = {"joint_states", "joint_trajectory", "target_gains", "target_pose", "episode/tick", "episode/phase"}
ALLOWED = {
    "keypoint_detector": {"camera/image_raw", "camera/camera_info"},
    "pre_contact": {"episode/phase", "goal_keypoints", "keypoints"},
    "approach": {"gripper_command", "pre_contact_pose", "keypoints", "joint_states"},
    "post_contact": {"goal_keypoints", "keypoints", "episode/tick", "joint_states"},
    "episode": {"goal_pose", "keypoints", "joint_trajectory", "approach/refusal", "diagnostics"},
    "joint_impedance": LEADING,
}
OF_ROS = {"parameter_events", "clock"}


def subscriptions(probe, node):
    """Topics, without the leading slash, that a node subscribes to."""
    # Known by its topics, a node may not be known by its name yet, or no more on a busy machine.
    probe.wait_until(lambda: node in probe.node.get_node_names(), what=f"the name of {node}")
    topics = {name.lstrip("/") for name, _ in probe.node.get_subscriber_names_and_types_by_node(node, "/")}
    return topics - OF_ROS


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    with Graph(tmp_path_factory.mktemp("isolation") / "log") as graph:
        yield graph


def test_the_policy_path_does_not_hear_the_truth(graph, probe, tmp_path):
    phases = probe.collect("episode/phase", DiagnosticArray, qos.LATCHED)
    poses = probe.collect("object_pose", PoseStamped)
    names = graph.bring_to(card_specs(weights=str(write_weights(tmp_path))))
    probe.wait_until_ready(names)
    policy_path = names - {"sim_bridge"}
    assert len(policy_path) == 6

    def check():
        assert subscriptions(probe, "probe") >= {"object_pose"}  # the question is answered at all
        assert set(probe.subscribers("object_pose")) == {"probe"}
        for node in policy_path:
            # What is known of a node grows as it is found; what is not allowed is not waited for.
            probe.wait_until(lambda: subscriptions(probe, node) >= ALLOWED[node], what=f"the subscriptions of {node}")
            assert subscriptions(probe, node) == ALLOWED[node], node

    check()
    assert reset(probe)
    probe.wait_until(lambda: phases, what="the phase of before")
    phases.clear()
    probe.wait_until(lambda: probe.call("episode/start").success, what="a start")
    # As far as an untrained detector leads: every node of the path but post_contact has worked then.
    probe.wait_until(
        lambda: phases and phase_state(phases[-1]).phase not in ("idle", "pre"), what="the end of phase pre"
    )
    probe.wait_until(lambda: poses, what="the truth")
    check()  # nobody has subscribed meanwhile
