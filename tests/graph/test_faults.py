"""Faults injected into a running card graph: each ends in a named phase, with the arm at rest. Nobody in the policy path hears the truth.

One graph for all: every test finds it as the fault before has left it, and the next episode runs.
"""

import signal
import sys

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from graph_tools import Graph, card_specs, command, reset
from sensor_msgs.msg import JointState

from np_control.safety import LIMITS
from np_description.message_arrays import joint_state_arrays, stamp_nanoseconds
from np_description.panda import STATE_NAMES
from np_description.phases import ENDS
from np_ros import qos
from np_ros.phases import phase_state
from np_ros.processes.graph import NodeSpec

# Who gives up first: the backend, where its answers are missing, or the episode, where its inputs are.
BACKEND_FIRST = {"sim_bridge": {"lockstep_timeout": 10.0}}
NO_PLAN = {**BACKEND_FIRST, "episode": {"planning": 2.0}}
NO_KEYPOINTS = {"sim_bridge": {**BACKEND_FIRST["sim_bridge"], "camera": False}, "episode": {"silence": 2.0}}

# Topics that docs/reference/graph.md gives to each node of the policy path.
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

NAN_CONTROLLER = """
import rclpy
from np_ros import qos
from np_description.message_arrays import stamp_nanoseconds
from np_ros.messages import joint_state_message
from np_ros.node import Diagnostics, run
from np_description.panda import JOINT_NAMES
from rclpy.node import Node
from sensor_msgs.msg import JointState

class NanController(Node):
    def __init__(self):
        super().__init__("nan_controller")
        self.diagnostics = Diagnostics(self)
        self.publisher = self.create_publisher(JointState, "effort_command", qos.LOCKSTEP)
        self.create_subscription(JointState, "joint_states", self.answer, qos.LOCKSTEP)

    def answer(self, state):
        if self.count_publishers("effort_command") > 1:
            return  # the other controller is still there
        position = list(state.position[:7])
        stamp = stamp_nanoseconds(state.header.stamp)
        command = joint_state_message(stamp, JOINT_NAMES, position, [0.0] * 7, [0.0] * 7)
        command.effort[3] = float("nan")
        self.publisher.publish(command)

raise SystemExit(run(NanController))
"""


class Episode:
    """An episode of `graph`: how to bring it about, and what the tests look at, phases and joint states."""

    def __init__(self, graph, probe, weights):
        self.graph, self.probe, self.weights = graph, probe, str(weights)
        self.phases = probe.collect("episode/phase", DiagnosticArray, qos.RECORDER_LATCHED)  # each of several in a row
        self.states = probe.collect("joint_states", JointState, qos.RECORDER)

    def start(self, overrides=BACKEND_FIRST, leave_out=(), beside=(), keypoints="truth"):
        """Bring the graph to these nodes, and into an episode whatever the one before has come to."""
        specs = card_specs(overrides, leave_out=leave_out, keypoints=keypoints, weights=self.weights)
        self.probe.wait_until_ready(self.graph.bring_to([*specs, *beside]))
        self.probe.wait_until(self.is_reset, what="a reset")
        self.probe.wait_until(lambda: self.phases, what="the phase of before")
        self.phases.clear()
        self.probe.wait_until(lambda: self.probe.call("episode/start").success, what="a start")

    def is_reset(self):
        """Whether the backend takes a reset; if not, recover for the next time."""
        if reset(self.probe):
            return True
        self.probe.call("sim_bridge/recover")  # refused while the arm still moves
        return False

    def wait_for(self, phase):
        """Until the phase is in force; fails with what was said where the episode ends before."""

        def has_come():
            said = [phase_state(message) for message in self.phases]
            began = max((i for i, state in enumerate(said) if state.phase == "pre"), default=len(said))
            names = {state.phase for state in said[began:]}
            assert phase in names or not names.intersection(ENDS), f"expected {phase}, got {said}"
            return phase in names

        self.probe.wait_until(has_come, what=f"phase {phase}")

    def wait_for_motion(self, phase):
        """Until the phase is in force and the arm has been commanded for 0.3 s of it."""
        self.wait_for(phase)
        before = self.stamp
        self.probe.wait_until(lambda: self.stamp >= before + 300_000_000, what=f"0.3 s of phase {phase}")

    def end(self):
        """The phase that ended the episode and its reason, once the arm is at rest."""

        def has_ended():
            said = [phase_state(message).phase for message in self.phases]  # the end of the one before may come first
            return "pre" in said and said[-1] in ENDS

        self.probe.wait_until(has_ended, what="the end of the episode")
        self.probe.wait_until(self.is_at_rest, what="the arm at rest")
        last = phase_state(self.phases[-1])
        return last.phase, last.reason

    def is_at_rest(self):
        _, velocity, _ = joint_state_arrays(self.states[-1], STATE_NAMES)
        return np.abs(velocity[:7]).max() < LIMITS.rest_speed

    @property
    def stamp(self):
        return stamp_nanoseconds(self.states[-1].header.stamp)


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    with Graph(tmp_path_factory.mktemp("faults") / "log") as graph:
        yield graph


@pytest.fixture
def episode(graph, probe, untrained):
    return Episode(graph, probe, untrained)


def test_a_controller_that_turns_to_nan(graph, episode, monkeypatch):
    monkeypatch.setattr(
        graph,
        "_locate",
        lambda package, executable: (
            [sys.executable, "-c", NAN_CONTROLLER] if package == "none" else command(package, executable)
        ),
    )
    episode.start(beside=[NodeSpec("none", "nan_controller")])
    episode.wait_for_motion("approach")
    graph.stop("joint_impedance")
    phase, reason = episode.end()
    assert phase == "fault" and "silence" in reason


@pytest.mark.parametrize(
    "victim, number, topic",
    [
        ("joint_impedance", signal.SIGKILL, "effort_command"),
        pytest.param("post_contact", signal.SIGTERM, "target_pose", marks=pytest.mark.slow),
    ],
)
def test_a_node_killed_while_the_arm_pushes(graph, probe, episode, victim, number, topic):
    episode.start()
    episode.wait_for_motion("post")
    graph.kill(victim, number)
    phase, reason = episode.end()
    assert phase == "fault" and topic in reason
    refused = probe.call("sim_bridge/reset")
    assert not refused.success and "recover" in refused.message


@pytest.mark.slow
def test_a_planner_killed_before_it_plans(episode):
    episode.start(NO_PLAN, leave_out=["approach"])  # however slowly keypoints come
    phase, reason = episode.end()
    assert phase == "failed" and reason == "approach: no joint_trajectory within 2 s"


def test_a_silent_camera(episode):
    episode.start(NO_KEYPOINTS, keypoints="camera")
    phase, reason = episode.end()
    assert phase == "failed" and reason == "pre: no keypoints within 2 s"


def subscriptions(probe, node):
    """Topics, without the leading slash, that a node subscribes to."""
    # Known by its topics, a node may not be known by its name yet, or no more on a busy machine.
    probe.wait_until(lambda: node in probe.node.get_node_names(), what=f"the name of {node}")
    topics = {name.lstrip("/") for name, _ in probe.node.get_subscriber_names_and_types_by_node(node, "/")}
    return topics - OF_ROS


def check_isolation(probe):
    """Nobody but the probe hears the truth, and each node what `ALLOWED` gives it."""
    assert set(probe.subscribers("object_pose")) == {"probe"}
    for node, allowed in ALLOWED.items():
        # What is known of a node grows as it is found; what is not allowed is not waited for.
        probe.wait_until(lambda: subscriptions(probe, node) >= allowed, what=f"the subscriptions of {node}")
        assert subscriptions(probe, node) == allowed, node


def test_the_policy_path_does_not_hear_the_truth(graph, probe, episode):
    poses = probe.collect("object_pose", PoseStamped)
    episode.start({}, keypoints="camera")
    assert set(graph.names) == {"sim_bridge", *ALLOWED}
    # As far as an untrained detector leads: every node of the path but post_contact has worked then.
    probe.wait_until(
        lambda: episode.phases and phase_state(episode.phases[-1]).phase not in ("idle", "pre"),
        what="the end of phase pre",
    )
    probe.wait_until(lambda: poses, what="the truth")
    check_isolation(probe)


@pytest.mark.slow
def test_a_new_episode_after_a_fault(graph, probe, episode):
    """A controller that came back: recover, reset, and the episode runs."""
    episode.start()
    episode.wait_for_motion("approach")
    graph.kill("joint_impedance")
    assert episode.end()[0] == "fault"
    episode.start()
    episode.wait_for("post")


@pytest.mark.slow
def test_a_new_episode_after_a_restart_of_the_backend(graph, episode):
    """Its time begins anew, and what the others remember of the time before must not stand in the way."""
    episode.start()
    episode.wait_for_motion("approach")
    graph.stop("sim_bridge")
    episode.start()
    episode.wait_for("post")
    stamps = [stamp_nanoseconds(state.header.stamp) for state in episode.states]
    assert np.diff(stamps).min() < 0, "expected a backend that begins anew"
