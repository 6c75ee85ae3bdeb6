"""`joint_names` between the graph and a backend that calls its joints otherwise, in an order of its own."""

import os
import subprocess
import sys

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph_tools import ROOT
from sensor_msgs.msg import JointState

from np_bringup.nodes.joint_names_node import JointNameMap
from np_description.message_arrays import BadMessage, joint_state_arrays, stamp_nanoseconds
from np_description.panda import JOINT_NAMES, NOMINAL, STATE_NAMES
from np_ros.messages import joint_state_message

FR3 = [name.replace("panda", "fr3") for name in STATE_NAMES]
"""As Franka's own driver calls the arm of today."""
BACKWARDS = f"""
import sys
sys.path.insert(0, {str(ROOT / "examples")!r})
from dataclasses import replace
from importlib import import_module
from np_ros.messages import joint_state_message
from np_ros.node import run

mine = import_module("08_minimal_backend")
JOINTS = {tuple(FR3[:7])!r}

def backwards(stamp, names, *values):
    names = [name.replace("panda", "fr3") for name in names]
    return joint_state_message(stamp, names[::-1], *(array[::-1] for array in values))

mine.joint_state_message = backwards
filter_of = mine.SafetyFilter
mine.SafetyFilter = lambda: filter_of(replace(mine.LIMITS, joints=JOINTS))
sys.exit(run(mine.MinimalBackend))
"""


def state(names, number=1.0):
    """A state whose numbers tell the joints apart."""
    rows = number + np.arange(3 * len(names)).reshape(3, -1)
    return joint_state_message(7_000_000, names, *rows)


def test_numbers_go_with_their_names():
    there = state(FR3)
    for what in ("position", "velocity", "effort"):
        setattr(there, what, getattr(there, what)[::-1])
    there.name = there.name[::-1]
    ours = JointNameMap("fr3").to_ours(there, STATE_NAMES)
    assert np.array_equal(joint_state_arrays(ours, STATE_NAMES), joint_state_arrays(state(FR3), FR3))
    assert stamp_nanoseconds(ours.header.stamp) == 7_000_000
    command = JointNameMap(",".join(FR3)).to_theirs(state(JOINT_NAMES))
    assert np.array_equal(joint_state_arrays(command, FR3[:7]), joint_state_arrays(state(JOINT_NAMES), JOINT_NAMES))


def test_what_names_other_joints_is_refused_and_a_command_left_as_it_is():
    with pytest.raises(BadMessage, match="expected .*'fr3_joint1'.* in any order, got .*'panda_joint1'"):
        JointNameMap("fr3").to_ours(state(STATE_NAMES), STATE_NAMES)
    assert list(JointNameMap("fr3").to_theirs(state(JOINT_NAMES[::-1])).name) == list(JOINT_NAMES[::-1])


@pytest.mark.parametrize("given", ["", "a,b", ",".join([*FR3[:8], FR3[0]])])
def test_names_that_cannot_be_are_told(given):
    with pytest.raises(ValueError, match="expected a prefix, or 9 different names by commas, got"):
        JointNameMap(given)


def test_a_controller_moves_the_arm_behind_it(graph, probe, tmp_path):
    (tmp_path / "backwards.py").write_text(BACKWARDS)
    told, states = probe.collect("diagnostics", DiagnosticArray), probe.collect("joint_states", JointState)
    renamed = [f"{topic}:=arm/{topic}" for topic in ("joint_states", "applied_command", "effort_command")]
    remappings = [word for topic in renamed for word in ("-r", topic)]
    backend = [sys.executable, str(tmp_path / "backwards.py"), "--ros-args", *remappings]

    def is_moving():
        said = [status for array in told for status in array.status if status.name == "/minimal_backend"]
        return any(pair.key == "state" and pair.value == "moving" for status in said for pair in status.values)

    with subprocess.Popen(backend, env={**os.environ, **graph.environment}) as arm:
        try:
            graph.run("np_bringup", "joint_names", {"names": "fr3"})
            graph.run("np_control", "joint_impedance", {"mode": "realtime"})
            probe.wait_until(lambda: is_moving() and states, what="commands that the arm takes, and its states")
        finally:
            arm.terminate()
    position, _, _ = joint_state_arrays(states[-1], STATE_NAMES)
    assert np.abs(position[:7] - NOMINAL.ready).max() < 0.1  # in our order: the postures of two joints differ by more
