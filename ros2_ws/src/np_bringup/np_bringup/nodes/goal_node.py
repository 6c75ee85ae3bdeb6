"""`goal`: a task for a real robot, whose driver draws none: the object's goal, published once and latched.

It has to be one that the policies were trained for: a place in a goal region of the domain, resting on that region's
surface, on the faces it may rest on there.
"""

from __future__ import annotations

from math import pi

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from np_description.domains import DOMAINS, Domain, Pose, find_domain, resting_pose
from np_description.panda import BASE_FRAME
from np_ros import qos
from np_ros.messages import BadMessage, pose_message, stamp_nanoseconds
from np_ros.node import Diagnostics, parameter, run

MARGIN = 1e-6  # m or rad


def goal_pose(domain: Domain, x: float, y: float, yaw: float, roll_turns: int = 0, pitch_turns: int = 0) -> Pose:
    """The goal at x, y m with yaw rad, in the region of the domain's goals that holds it.

    Raises ValueError where no region does, or where it would rest on a face that policies have not been asked for.
    """
    region = next((r for r in domain.goals if _holds(r.x, x) and _holds(r.y, y) and _holds(r.yaw, yaw)), None)
    if region is None:
        regions = "; ".join(f"x {r.x}, y {r.y} m, yaw {np.round(r.yaw, 2).tolist()} rad" for r in domain.goals)
        raise ValueError(f"goal: expected one of {domain.name}'s goals ({regions}), got x {x}, y {y}, yaw {yaw:.2f}")
    if (roll_turns or pitch_turns) and not region.quarter_turns:
        raise ValueError(
            f"goal: expected no roll_turns and pitch_turns for {domain.name}, which has but one face to rest on, "
            f"got {roll_turns} and {pitch_turns}"
        )
    pitch = pitch_turns * pi / 2 if region.quarter_turns else region.pitch
    return resting_pose(domain, region, x, y, yaw, roll_turns * pi / 2, pitch)


def _holds(limits: tuple[float, float], value: float) -> bool:
    return limits[0] - MARGIN <= value <= limits[1] + MARGIN


class Goal(Node):
    """Publishes the goal with the stamp of the first joint state, which is on the backend's clock."""

    def __init__(self):
        super().__init__("goal")
        domain = find_domain(parameter(self, "domain", "card", "Task family.", choices=tuple(DOMAINS)))
        x = parameter(
            self, "x", np.mean(domain.goals[0].x).item(), "Of the object's centre in the base frame, m.", 0.0, 1.0
        )
        y = parameter(self, "y", np.mean(domain.goals[0].y).item(), "The same.", -1.0, 1.0)
        yaw = parameter(self, "yaw", 0.0, "About the vertical, rad.", -pi, pi)
        turns = [
            parameter(self, f"{name}_turns", 0, f"Quarter turns of {name} before it: on which face it rests.", 0, 3)
            for name in ("roll", "pitch")
        ]
        pose = goal_pose(domain, x, y, yaw, *turns)
        self._pose = pose.position, pose.quaternion
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
