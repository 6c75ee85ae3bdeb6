"""`ros2_control`: hands the graph's joint targets, plans and gains to a torque controller of ros2_control.

It subscribes to `effort_command` (our controller's joint target), `joint_trajectory`, `target_gains` and `joint_states`. A plan
goes to joint_trajectory_controller as a whole.
"""

from __future__ import annotations

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from np_control.ros2_control import (
    CONTROLLERS,
    CRISP,
    as_controller_takes,
    check_trajectory,
    gain_parameters,
    target_trajectory,
)
from np_control.safety import LIMITS
from np_description.message_arrays import BadMessage, gains_array, joint_state_arrays
from np_description.panda import JOINT_NAMES, STATE_NAMES
from np_ros import qos
from np_ros.node import Diagnostics, parameter, run


class Ros2ControlNode(Node):
    """One controller, which has to be active."""

    def __init__(self) -> None:
        super().__init__("ros2_control")
        self._kind = parameter(self, "controller", CRISP, "Which controller runs.", choices=CONTROLLERS)
        name = parameter(self, "controller_name", "joint_impedance_controller", "Its node in the controller manager.")
        prefix = parameter(self, "names", "fr3", "The controller's prefix of joint names in place of panda.")
        self._joints = tuple(joint.replace("panda", prefix, 1) for joint in JOINT_NAMES)
        self.diagnostics = Diagnostics(self)
        self._measured: np.ndarray | None = None
        self._plan_ends = self.get_clock().now()
        self._gains = AsyncParameterClient(self, name)
        stream = qos.REALTIME_SUBSCRIBER
        if self._kind == CRISP:
            self._targets = self.create_publisher(JointState, "target_joint", qos.EVENT)
        else:
            self._targets = self.create_publisher(JointTrajectory, f"{name}/joint_trajectory", qos.EVENT)
            self.create_subscription(JointTrajectory, "joint_trajectory", self._on_plan, qos.EVENT)
            self.create_subscription(JointState, "joint_states", self._on_state, stream)
        self.create_subscription(JointState, "effort_command", self._on_command, stream)
        self.create_subscription(Float64MultiArray, "target_gains", self._on_gains, stream)

    def _on_state(self, message: JointState) -> None:
        try:
            self._measured = joint_state_arrays(message, STATE_NAMES)[0][:7]
        except BadMessage as error:
            self.diagnostics.refuse(error.kind, error)

    def _on_command(self, message: JointState) -> None:
        """The joint target of our controller; its torque is for backends that take torques."""
        try:
            target = joint_state_arrays(message, JOINT_NAMES)[0]
        except BadMessage as error:
            return self.diagnostics.refuse(error.kind, error)
        if self._kind == CRISP:
            self._targets.publish(JointState(header=message.header, name=self._joints, position=target.tolist()))
        elif self.get_clock().now() >= self._plan_ends:  # until then it follows the plan by itself
            self._targets.publish(target_trajectory(self._joints, target))

    def _on_plan(self, message: JointTrajectory) -> None:
        if not message.points or self._measured is None:
            return
        plan = as_controller_takes(message, self._joints)
        try:
            check_trajectory(plan, self._joints, self._measured, LIMITS)
        except BadMessage as error:
            return self.diagnostics.refuse(error.kind, error)
        self._plan_ends = self.get_clock().now() + Duration.from_msg(plan.points[-1].time_from_start)
        self._targets.publish(plan)

    def _on_gains(self, message: Float64MultiArray) -> None:
        try:
            gains = gain_parameters(self._kind, self._joints, *gains_array(message))
        except BadMessage as error:
            return self.diagnostics.refuse(error.kind, error)
        if not self._gains.services_are_ready():
            return self.diagnostics.count("gains_without_controller")
        self._gains.set_parameters([Parameter(name, value=value) for name, value in gains.items()])


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `ros2_control`."""
    return run(Ros2ControlNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
