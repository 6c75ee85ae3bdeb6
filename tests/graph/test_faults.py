"""Faults injected into a running card graph: each ends in a named phase, with the arm at rest."""

import signal
import sys

import numpy as np
import pytest
from np_bringup.contract import END_PHASES, split_phase
from np_control.safety import LIMITS
from np_description.panda import STATE_NAMES
from np_ros import qos
from np_ros.messages import joint_state_arrays, stamp_nanoseconds
from sensor_msgs.msg import JointState
from std_msgs.msg import String

# Who gives up first: the episode, where its inputs are missing, or the backend, where its answers are.
EPISODE_FIRST = {"episode": {"silence": 2.0, "planning": 8.0}}
BACKEND_FIRST = {"sim_bridge": {"lockstep_timeout": 10.0}}

NAN_CONTROLLER = """
import rclpy
from np_ros import qos
from np_ros.messages import joint_state_message, stamp_nanoseconds
from np_ros.node import Diagnostics, run
from np_description.panda import JOINT_NAMES
from rclpy.node import Node
from sensor_msgs.msg import JointState

class NanController(Node):
    def __init__(self):
        super().__init__("joint_impedance")
        self.diagnostics = Diagnostics(self)
        self.publisher = self.create_publisher(JointState, "effort_command", qos.LOCKSTEP)
        self.create_subscription(JointState, "joint_states", self.answer, qos.LOCKSTEP)

    def answer(self, state):
        position = list(state.position[:7])
        stamp = stamp_nanoseconds(state.header.stamp)
        command = joint_state_message(stamp, JOINT_NAMES, position, [0.0] * 7, [0.0] * 7)
        command.effort[3] = float("nan")
        self.publisher.publish(command)

raise SystemExit(run(NanController))
"""


class Episode:
    """What the tests look at: phases and joint states of an episode under way."""

    def __init__(self, probe):
        self.probe = probe
        self.phases = probe.collect("phase", String, qos.LATCHED)
        self.states = probe.collect("joint_states", JointState, qos.RECORDER)

    def start(self, names):
        self.probe.wait_until_ready(names)
        assert self.probe.call("sim_bridge/reset").success
        assert self.probe.call("episode/start").success

    def wait_for(self, phase):
        self.probe.wait_until(
            lambda: any(split_phase(m.data)[0] == phase for m in self.phases), what=f"phase {phase}"
        )

    def wait_for_motion(self, phase):
        """Until the phase is in force and the arm has been commanded for 0.3 s of it."""
        self.wait_for(phase)
        before = self.stamp
        self.probe.wait_until(lambda: self.stamp >= before + 300_000_000, what=f"0.3 s of phase {phase}")

    def end(self):
        """The phase that ended the episode and its reason, once the arm is at rest."""
        self.probe.wait_until(
            lambda: split_phase(self.phases[-1].data)[0] in END_PHASES, what="the end of the episode"
        )
        self.probe.wait_until(self.is_at_rest, what="the arm at rest")
        return split_phase(self.phases[-1].data)

    def is_at_rest(self):
        _, velocity, _ = joint_state_arrays(self.states[-1], STATE_NAMES)
        return np.abs(velocity[:7]).max() < LIMITS.rest_speed

    @property
    def stamp(self):
        return stamp_nanoseconds(self.states[-1].header.stamp)


@pytest.fixture
def episode(graph, probe, untrained):
    return Episode(probe)


def test_a_controller_that_turns_to_nan(graph, probe, episode, untrained, monkeypatch):
    # With the usual patience: simulated time stands still until the other controller is up.
    names = graph.run_card({}, keypoints="truth", weights=str(untrained))
    episode.start(names)
    episode.wait_for_motion("approach")
    graph.kill("joint_impedance")
    monkeypatch.setattr(graph, "_locate", lambda package, executable: [sys.executable, "-c", NAN_CONTROLLER])
    graph.run("none", "joint_impedance")
    phase, reason = episode.end()
    assert phase == "fault" and reason


@pytest.mark.parametrize(
    "victim, number, topic",
    [("joint_impedance", signal.SIGKILL, "effort_command"), ("post_contact", signal.SIGTERM, "target_pose")],
)
def test_a_node_killed_while_the_arm_pushes(graph, probe, episode, untrained, victim, number, topic):
    names = graph.run_card(BACKEND_FIRST, keypoints="truth", weights=str(untrained))
    episode.start(names)
    episode.wait_for_motion("post")
    graph.kill(victim, number)
    phase, reason = episode.end()
    assert phase == "fault" and topic in reason
    refused = probe.call("sim_bridge/reset")
    assert not refused.success and "recover" in refused.message


def test_a_planner_killed_before_it_plans(graph, probe, episode, untrained):
    names = graph.run_card(
        EPISODE_FIRST, leave_out=["approach"], keypoints="truth", weights=str(untrained)
    )
    episode.start(names)
    phase, reason = episode.end()
    assert phase == "failed" and reason == "approach: no joint_trajectory within 8 s"


def test_a_silent_camera(graph, probe, episode, untrained):
    names = graph.run_card({**EPISODE_FIRST, "sim_bridge": {"camera": False}}, weights=str(untrained))
    episode.start(names)
    phase, reason = episode.end()
    assert phase == "failed" and reason == "pre: no keypoints within 2 s"


def test_a_new_episode_after_a_fault(graph, probe, episode, untrained):
    """A controller that came back: recover, reset, and the episode runs."""
    names = graph.run_card(BACKEND_FIRST, keypoints="truth", weights=str(untrained))
    episode.start(names)
    episode.wait_for_motion("approach")
    graph.kill("joint_impedance")
    assert episode.end()[0] == "fault"
    graph.run("np_control", "joint_impedance", {"mode": "lockstep"})
    probe.wait_until_ready(names)
    probe.wait_until(lambda: probe.call("sim_bridge/recover").success, what="recovery")
    episode.phases.clear()
    probe.wait_until(lambda: probe.call("sim_bridge/reset").success, what="a reset")
    probe.wait_until(lambda: probe.call("episode/start").success, what="a start")
    episode.wait_for("post")
