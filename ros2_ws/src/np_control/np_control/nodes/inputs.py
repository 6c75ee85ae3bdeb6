"""The topics that lead a controller, read and checked: one place for the controller nodes and for the
driver.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray, Header, String
from trajectory_msgs.msg import JointTrajectory

from np_common.rotations import matrix_from_quaternion
from np_control.safety import Refusal, SafetyLimits
from np_control.trajectory import Trajectory, make_trajectory
from np_description.message_arrays import BadMessage, gains_array, pose_arrays, stamp_nanoseconds, trajectory_arrays
from np_description.panda import BASE_FRAME, JOINT_NAMES
from np_description.phases import PhaseState
from np_ros import qos
from np_ros.phases import HEARTBEAT, heartbeat_phase, phase_state

Pose = tuple[np.ndarray, np.ndarray]  # position (3,) m, rotation (3, 3)


class CommandSink(Protocol):
    """The receiver of inputs. None stands for a refused message, or for a trajectory without a plan."""

    def on_trajectory(self, stamp: int, trajectory: Trajectory | None) -> None:
        """A plan for the state of `stamp` ns."""

    def on_gains(self, gains: np.ndarray | None) -> None:
        """Gains (2, 7) for the pose that comes next."""

    def on_pose(self, stamp: int, pose: Pose | None) -> None:
        """A target of T_E for the state of `stamp` ns."""

    def on_tick(self, stamp: int, state: PhaseState) -> None:
        """A policy tick, and the phase in force from it on."""

    def on_phase(self, state: PhaseState) -> None:
        """The phase of the episode."""

    def on_heartbeat(self, phase: str) -> None:
        """Real time: the owner of the phase still runs."""

    def refuse(self, error: BadMessage | Refusal) -> None:
        """Count a message that is not carried out."""


def subscribe(node: Node, led: CommandSink, limits: SafetyLimits, *, lockstep: bool) -> None:
    """Let the topics of docs/reference/graph.md lead `led`; `limits` are those that trajectories must keep."""

    def read(header: Header, translate: Callable[[], object], deliver: Callable[[int, object], None]) -> None:
        """Deliver a message under its stamp, None in its place where its content is refused; without a readable
        stamp nothing.
        """
        try:
            stamp = stamp_nanoseconds(header.stamp)
        except BadMessage as error:
            led.refuse(error)
            return
        deliver(stamp, check(translate))

    def check(translate: Callable[[], object]) -> object:
        try:
            return translate()
        except (BadMessage, Refusal) as error:
            led.refuse(error)
            return None

    def tick(message: DiagnosticArray) -> None:
        if (state := check(lambda: phase_state(message))) is not None:  # without a phase no node can go on
            read(message.header, lambda: state, led.on_tick)

    def phase(message: DiagnosticArray) -> None:
        if (state := check(lambda: phase_state(message))) is not None:
            led.on_phase(state)

    def heartbeat(message: String) -> None:
        if (sent := check(lambda: heartbeat_phase(message))) is not None:
            led.on_heartbeat(sent)

    def trajectory(message: JointTrajectory) -> Trajectory | None:
        times, positions, velocities = trajectory_arrays(message, JOINT_NAMES)
        # No points: a planner found no way and gives no reason; the arm stays where it is.
        return make_trajectory(times, positions, velocities, limits) if times.size else None

    def pose(message: PoseStamped) -> Pose:
        position, quaternion = pose_arrays(message, BASE_FRAME)
        return position, matrix_from_quaternion(quaternion)

    stream = qos.subscriber(lockstep)
    node.create_subscription(
        JointTrajectory,
        "joint_trajectory",
        lambda m: read(m.header, lambda: trajectory(m), led.on_trajectory),
        qos.EVENT,
    )
    node.create_subscription(
        Float64MultiArray, "target_gains", lambda m: led.on_gains(check(lambda: gains_array(m))), stream
    )
    node.create_subscription(PoseStamped, "target_pose", lambda m: read(m.header, lambda: pose(m), led.on_pose), stream)
    node.create_subscription(DiagnosticArray, "episode/tick", tick, stream)
    node.create_subscription(DiagnosticArray, "episode/phase", phase, qos.LATCHED)
    if not lockstep:
        node.create_subscription(String, HEARTBEAT, heartbeat, stream)
