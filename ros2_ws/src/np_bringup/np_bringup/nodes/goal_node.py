"""`goal`: a task for a real robot, whose driver draws none: the object's goal, published once and latched."""

from __future__ import annotations

from math import pi

import numpy as np
from geometry_msgs.msg import PoseStamped
from np_description.domains import DOMAINS, find_domain, is_lost, resting_height
from np_description.panda import BASE_FRAME
from np_description.rotations import yaw_quaternion
from np_ros import qos
from np_ros.messages import BadMessage, pose_message, stamp_nanoseconds
from np_ros.node import Diagnostics, parameter, run
from rclpy.node import Node
from sensor_msgs.msg import JointState


class Goal(Node):
    """Publishes the goal with the stamp of the first joint state, which is on the backend's clock."""

    def __init__(self):
        super().__init__("goal")
        domain = find_domain(parameter(self, "domain", "card", "Task family.", choices=tuple(DOMAINS)))
        x = parameter(self, "x", 0.5, "Of the object's centre in the base frame, m.", 0.0, 1.0)
        y = parameter(self, "y", 0.0, "The same.", -1.0, 1.0)
        surface = parameter(self, "surface", 0.0, "Height of what it rests on, m.", -0.1, 0.5)
        yaw = parameter(self, "yaw", 0.0, "About the vertical, rad.", -pi, pi)
        quaternion = yaw_quaternion(np.asarray(yaw))
        position = np.array([x, y, surface + resting_height(domain, quaternion)])
        if is_lost(domain, position):
            raise ValueError(
                f"goal: expected x in {domain.workspace_x} and y in {domain.workspace_y} m, "
                f"the workspace of {domain.name}, got {x}, {y}"
            )
        self._pose = position, quaternion
        self._diagnostics = Diagnostics(self)
        self._publisher = self.create_publisher(PoseStamped, "goal_pose", qos.LATCHED)
        self.create_subscription(JointState, "joint_states", self._on_state, qos.subscriber(lockstep=False))
        self._is_given = False

    def _on_state(self, message: JointState) -> None:
        if self._is_given:
            return
        try:
            stamp = stamp_nanoseconds(message.header.stamp)
        except BadMessage as error:
            self._diagnostics.count(f"refused_{error.kind}")
            return
        self._publisher.publish(pose_message(stamp, BASE_FRAME, *self._pose))
        self._is_given = True
        self._diagnostics.values["stamp"] = stamp
        self.get_logger().info(f"goal at {np.round(self._pose[0], 3).tolist()} m")


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `goal`."""
    return run(Goal, args)


if __name__ == "__main__":
    raise SystemExit(main())
