"""The bench's reference controller: it replies to every state with the present posture and no torque.

It uses rclpy's default executor and messages, to show what the graph's own controller adds or saves.
"""

from __future__ import annotations

from rclpy.node import Node
from sensor_msgs.msg import JointState

from np_description.panda import JOINT_NAMES
from np_ros import qos
from np_ros.node import Diagnostics, run


class Echo(Node):
    """`joint_states` to `effort_command`."""

    def __init__(self):
        super().__init__("echo")
        self._diagnostics = Diagnostics(self)
        self._command = self.create_publisher(JointState, "effort_command", qos.REALTIME_PUBLISHER)
        self.create_subscription(JointState, "joint_states", self._on_state, qos.REALTIME_SUBSCRIBER)

    def _on_state(self, state: JointState) -> None:
        zeros = [0.0] * 7
        self._command.publish(
            JointState(
                header=state.header,
                name=list(JOINT_NAMES),
                position=state.position[:7],
                velocity=zeros,
                effort=zeros,
            )
        )


def main(args=None):
    """Run the node, on rclpy's own executor, until SIGINT or SIGTERM."""
    return run(Echo, args, fast=False)


if __name__ == "__main__":
    raise SystemExit(main())
