"""Messages to the controller's node, its commands and its counts."""

import numpy as np

from np_common.rotations import quaternion_from_matrix
from np_control.impedance import STIFFNESS_MIN
from np_control.kinematics import forward_kinematics
from np_control.safety import LIMITS
from np_description.message_arrays import joint_state_arrays, stamp_nanoseconds
from np_description.panda import JOINT_NAMES, NOMINAL
from np_description.phases import PhaseState
from np_ros import qos
from np_ros.messages import trajectory_message
from np_ros.phases import phase_message

PERIOD = LIMITS.period_ns
TICK = 50 * PERIOD
GAINS = np.stack([2 * STIFFNESS_MIN, np.ones(7)])
POSITION, ROTATION = forward_kinematics(NOMINAL.ready)
QUATERNION = quaternion_from_matrix(ROTATION)


def plan(stamp, times, goal):
    """A trajectory of two points at rest, from ready."""
    return trajectory_message(stamp, JOINT_NAMES, times, [NOMINAL.ready, goal], np.zeros((2, 7)))


def answers(probe):
    return [stamp_nanoseconds(message.header.stamp) for message in probe.messages["effort_command"]]


def answered(probe, stamp):
    probe.wait_until(lambda: stamp in answers(probe), what=f"the answer to {stamp} ns")
    last = [m for m in probe.messages["effort_command"] if stamp_nanoseconds(m.header.stamp) == stamp][-1]
    return joint_state_arrays(last, JOINT_NAMES)


def is_counted(probe, key):
    return any(
        pair.key == key and int(pair.value) >= 1
        for array in probe.messages["diagnostics"]
        for status in array.status
        for pair in status.values
    )


def counted(probe, key):
    probe.wait_until(lambda: is_counted(probe, key), what=f"{key} in diagnostics")


def publish_phase(probe, phase, reason=""):
    """Publish a phase; the node has received it two states later."""
    probe.publish("episode/phase", phase_message(PhaseState(phase, reason)), qos.LATCHED)
    probe.wait_until(lambda: probe.all_acknowledged("episode/phase"))
