"""Nodes as simulated processes, see simulated_tools."""

from functools import cache

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from policy_path import HAND, INPUTS, NODES, OUTPUTS, Backend
from policy_weights import write_policies
from sensor_msgs.msg import JointState
from simulated_tools import InProcessGraph, InProcessProbe
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from np_description.domains import CARD
from np_description.panda import NOMINAL, STATE_NAMES
from np_ros import qos
from np_ros.messages import joint_state_message


@pytest.fixture
def graph():
    """Starts nodes."""
    return InProcessGraph()


@pytest.fixture
def probe(graph):
    """A peer of the nodes of `graph`."""
    return InProcessProbe(graph)


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    """Maps a position of the hand, m, to a folder of policies whose student chooses it."""
    return cache(lambda position: str(write_policies(tmp_path_factory.mktemp("weights"), CARD, position=position)))


@pytest.fixture
def begin(graph, probe, weights):
    """Starts the four nodes with a student that chooses `position`, m; options: parameters of `episode`."""

    def begun(position=HAND, mode="lockstep", **episode):
        for topic, (kind, profile) in OUTPUTS.items():
            probe.collect(topic, kind, profile)
        probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
        for topic, (kind, profile) in INPUTS.items():
            probe.advertise(topic, kind, profile)
        own = {
            "pre_contact": {"weights": weights(position)},
            "approach": {"improve_checks": 2000},
            "post_contact": {"weights": weights(HAND)},
            "episode": episode,
        }
        for name, given in own.items():
            graph.run("np_policy", name, {"mode": mode, "domain": "card", **given})
        probe.wait_until_ready(set(NODES))
        return Backend(probe, graph)

    return begun


@pytest.fixture
def start_controller(graph, probe):
    """Starts joint_impedance with these parameters and waits until all topics match."""

    def started(**parameters):
        inputs = [
            ("joint_states", JointState, qos.LOCKSTEP),
            ("episode/tick", DiagnosticArray, qos.LOCKSTEP),
            ("joint_trajectory", JointTrajectory, qos.EVENT),
            ("episode/phase", DiagnosticArray, qos.LATCHED),
            ("target_gains", Float64MultiArray, qos.LOCKSTEP),
            ("target_pose", PoseStamped, qos.LOCKSTEP),
        ]
        for topic, kind, profile in inputs:
            probe.advertise(topic, kind, profile)
        probe.collect("effort_command", JointState)
        probe.collect("diagnostics", DiagnosticArray, qos.EVENT)
        probe.wait_until_ready({graph.run("np_control", "joint_impedance", parameters)})

    return started


@pytest.fixture
def send_state(probe):
    """Publishes a state at rest with a stamp, in ns; by default in the ready posture."""

    def publish(stamp, joints=NOMINAL.ready, fingers=(0.0, 0.0)):
        position, still = [*joints, *fingers], np.zeros(9)
        probe.publish("joint_states", joint_state_message(stamp, STATE_NAMES, position, still, still))

    return publish
