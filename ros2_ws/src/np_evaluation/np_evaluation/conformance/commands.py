"""The commands that move a backend: effort commands, 500 times a second, or targets of T_E with their gains, ten times.

Either kind has commands for rest and for a turn of the last joint. It also has one wrong command for each reason
that refusals are counted by."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from np_common.rotations import quaternion_from_matrix
from np_control.impedance import STIFFNESS_MAX
from np_control.kinematics import forward_kinematics
from np_control.safety import LIMITS
from np_description.message_arrays import stamp_nanoseconds
from np_description.panda import BASE_FRAME, JOINT_NAMES
from np_ros.messages import gains_message, joint_state_message, pose_message

PERIOD = LIMITS.period_ns
POLICY_PERIOD = 100_000_000  # ns
GAINS = np.stack([STIFFNESS_MAX, np.ones(7)])
Command = JointState | dict[str, object]
Make = Callable[[JointState], Command]


@dataclass(frozen=True)
class BackendCommands:
    """One kind of command that moves a backend."""

    sent: dict[str, type]
    """Message types by topic."""
    period: int
    """Between two commands, ns."""
    subscribed: dict[str, str]
    """Types of the topics that a backend of this kind subscribes to."""
    published: dict[str, str]
    """Types of the topics that it publishes besides."""
    stay: Make
    """Makes a command that keeps the posture of a state."""
    turn: Make
    """Makes a command that turns the last joint."""
    turn_fast: Make
    """Makes a command that turns it over its speed limit."""
    bad: dict[str, Make]
    """Makes a command that must be refused, by reason."""


# Efforts


def stay(state: JointState, **changes) -> JointState:
    """The command to keep the present posture with no torque; fields replaced by keyword."""
    fields = dict(
        stamp=stamp_nanoseconds(state.header.stamp),
        names=JOINT_NAMES,
        position=list(state.position[:7]),
        velocity=[0.0] * 7,
        effort=[0.0] * 7,
    )
    fields.update(changes)
    return joint_state_message(
        fields["stamp"], fields["names"], fields["position"], fields["velocity"], fields["effort"]
    )


def pushing(torque: float) -> Callable[[JointState], JointState]:
    """A controller that commands the present posture, and `torque` Nm on the last joint."""
    return lambda state: stay(state, effort=[0.0] * 6 + [torque])


def _replace_entry(values, index, value):
    """`values` as a list with one entry replaced."""
    result = list(values)
    result[index] = value
    return result


def _without_last_effort(state):
    """A command with an effort missing."""
    command = stay(state)
    command.effort = command.effort[:6]
    return command


EFFORTS = BackendCommands(
    sent={"effort_command": JointState},
    period=PERIOD,
    subscribed={"/effort_command": "sensor_msgs/msg/JointState"},
    published={},
    stay=stay,
    turn=pushing(1.5),
    turn_fast=pushing(11.5),
    bad={
        "not_finite": lambda s: stay(s, effort=[0.0, math.nan] + [0.0] * 5),
        "names": lambda s: stay(s, names=tuple(reversed(JOINT_NAMES))),
        "length": _without_last_effort,
        "torque": lambda s: stay(s, effort=_replace_entry([0.0] * 7, 6, 1.01 * LIMITS.torque[6])),
        "velocity": lambda s: stay(s, velocity=_replace_entry([0.0] * 7, 0, 1.01 * LIMITS.velocity[0])),
        "position": lambda s: stay(s, position=_replace_entry(s.position[:7], 0, 1.01 * LIMITS.position_upper[0])),
        "start": lambda s: stay(
            s, position=_replace_entry(s.position[:7], 2, s.position[2] + 2 * LIMITS.start_tolerance)
        ),
        "future": lambda s: stay(s, stamp=stamp_nanoseconds(s.header.stamp) + 1000 * PERIOD),
    },
)


# Targets


def target(
    state: JointState,
    *,
    ahead: float = 0.0,
    shift=(0.0, 0.0, 0.0),
    frame: str = BASE_FRAME,
    late: int = 0,
    gains: np.ndarray = GAINS,
) -> dict[str, object]:
    """Gains and the pose that T_E has now, turned about its own axis by `ahead` rad of the last joint, and
    moved by `shift` m; its stamp `late` ns before the state's."""
    q = np.array(state.position[:7])
    q[6] = min(q[6] + ahead, LIMITS.position_upper[6] - 0.01)
    position, rotation = forward_kinematics(q)
    stamp = stamp_nanoseconds(state.header.stamp) - late
    pose = pose_message(stamp, frame, position + shift, quaternion_from_matrix(rotation))
    return {"target_gains": gains_message(gains), "target_pose": pose}


def _without_labels(state):
    """A target whose gains have a wrong label."""
    command = target(state)
    command["target_gains"].layout.dim[0].label = "row"
    return command


def _without_gains(state):
    """A pose without gains."""
    return {"target_pose": target(state)["target_pose"]}


TARGETS = BackendCommands(
    sent={"target_gains": Float64MultiArray, "target_pose": PoseStamped},
    period=POLICY_PERIOD,
    subscribed={
        "/target_pose": "geometry_msgs/msg/PoseStamped",
        "/target_gains": "std_msgs/msg/Float64MultiArray",
        "/joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
        "/episode/tick": "diagnostic_msgs/msg/DiagnosticArray",
        "/episode/phase": "diagnostic_msgs/msg/DiagnosticArray",
        "/episode/heartbeat": "std_msgs/msg/String",
    },
    published={"/effort_command": "sensor_msgs/msg/JointState"},
    stay=target,
    turn=lambda s: target(s, ahead=0.2),
    turn_fast=lambda s: target(s, ahead=1.0),
    bad={
        "finite": lambda s: target(s, shift=(0.0, math.nan, 0.0)),
        "frame": lambda s: target(s, frame="world"),
        "shape": _without_labels,
        "gains": lambda s: target(s, gains=np.stack([1.01 * STIFFNESS_MAX, np.ones(7)])),
        "workspace": lambda s: target(s, shift=(0.0, 1.0, 0.0)),
        "unpaired": _without_gains,
        "unreachable": lambda s: target(s, shift=(0.4, 0.3, 0.2)),
        "late": lambda s: target(s, late=600_000_000),
        "future": lambda s: target(s, late=-1_000_000_000),
    },
)
