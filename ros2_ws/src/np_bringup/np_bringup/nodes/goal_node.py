"""`goal`: a task for a robot whose backend draws none: the object's goal, published until the episode has it.

It has to be one that the policies were trained for: a place in a goal region of the domain, resting on that region's
surface, on the faces it may rest on there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from math import pi

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from np_common.cli import INTERRUPTED
from np_description.domains import Pose, Task, goal_region, resting_pose
from np_description.message_arrays import BadMessage, stamp_nanoseconds
from np_description.panda import BASE_FRAME
from np_ros import qos
from np_ros.client.services import Services, Wait
from np_ros.goals import GOAL, REFUSED, goal_text
from np_ros.low_latency.spin import Spinner
from np_ros.messages import pose_message
from np_ros.node import Diagnostics, parameter, run
from np_ros.task_domain import declare_domain

MARGIN = dict.fromkeys(("x", "y", "yaw"), 1e-6)  # m and rad: of rounding
EPISODE_LIMIT = 3600.0  # s; the episode node has limits of its own for every phase


def goal_pose(domain: Task, x: float, y: float, yaw: float, roll_turns: int = 0, pitch_turns: int = 0) -> Pose:
    """The goal at x, y m with yaw rad, in the region of the domain's goals that holds it.

    Raises ValueError where no region does, or where it would rest on a face on which no goal of the domain rests.
    """
    region = goal_region(domain, {"x": x, "y": y, "yaw": yaw}, MARGIN)
    if (roll_turns or pitch_turns) and not region.quarter_turns:
        raise ValueError(
            f"goal: expected no roll_turns and pitch_turns for {domain.name}, which has but one face to rest on, "
            f"got {roll_turns} and {pitch_turns}"
        )
    pitch = pitch_turns * pi / 2 if region.quarter_turns else region.pitch
    return resting_pose(domain, region, x, y, yaw, roll_turns * pi / 2, pitch)


class GoalNode(Node):
    """Publishes the goal with the stamp of the first joint state, which is on the backend's clock, and checks whether it is taken."""

    def __init__(self):
        super().__init__("goal")
        domain = declare_domain(self)
        x = parameter(
            self, "x", np.mean(domain.goals[0].x).item(), "Of the object's centre in the base frame, m.", 0.0, 1.0
        )
        y = parameter(self, "y", np.mean(domain.goals[0].y).item(), "The same.", -1.0, 1.0)
        yaw = parameter(self, "yaw", 0.0, "About the vertical, rad.", -pi, pi)
        turns = [
            parameter(self, f"{name}_turns", 0, f"Quarter turns of {name} before it: on which face it rests.", 0, 3)
            for name in ("roll", "pitch")
        ]
        self._runs = parameter(self, "run", False, "Whether to run the episode too, and to end with its outcome.")
        self._stays = parameter(
            self, "stay", False, "Whether to stay when it is taken: for a recorder that comes later."
        )
        self._limit = parameter(
            self, "limit", 30.0, "How long to wait for a backend and for an episode node, s.", 1.0, 3600.0
        )
        pose = goal_pose(domain, x, y, yaw, *turns)
        self._pose = pose.position, pose.quaternion
        self._diagnostics = Diagnostics(self)
        self._publisher = self.create_publisher(PoseStamped, "goal_pose", qos.LATCHED)
        self.create_subscription(JointState, "joint_states", self._on_state, qos.subscriber(lockstep=False))
        self.create_subscription(DiagnosticArray, "diagnostics", self._on_diagnostics, qos.EVENT)
        self._given: PoseStamped | None = None
        self._episode = ""  # what the episode node reported last
        self._is_taken = False
        self._refused = ""  # the goal and why

    def give(self, spinner: Spinner) -> int:
        """Publish the goal, wait until the episode has it, and go on by the parameters; the exit status."""
        log = self.get_logger()

        def wait(condition: Callable[[], object], limit: float, what: str) -> None:
            deadline = time.monotonic() + limit
            while not condition():
                if time.monotonic() > deadline:
                    raise TimeoutError(f"expected {what} within {limit:g} s, none came{self._episode}")
                spinner.spin_once(0.1)

        try:
            wait(lambda: self._given, self._limit, "joint_states of a backend in this ROS_DOMAIN_ID")
            wait(lambda: self._is_taken or self._refused, self._limit, "the node episode to take the goal")
            if self._refused:
                log.fatal(f"the node episode refused the goal {self._refused}")
                return 1
            self._publisher.wait_for_all_acked(Duration(seconds=1))
            log.info(f"goal taken: {goal_text(self._given)}")
            if self._runs:
                return self._run(wait)
        except TimeoutError as error:
            log.fatal(str(error))
            return 1
        if self._stays:
            with suppress(ExternalShutdownException):
                spinner.spin()
        return 0

    def _run(self, wait: Wait) -> int:
        answer = Services(self, wait).call(Trigger, "episode/run", Trigger.Request(), EPISODE_LIMIT)
        print(answer.message, flush=True)
        return 0 if answer.success else 1

    def _on_state(self, message: JointState) -> None:
        if self._given:
            return
        try:
            stamp = stamp_nanoseconds(message.header.stamp)
        except BadMessage as error:
            self._diagnostics.count(f"refused_{error.kind}")
            return
        self._given = pose_message(stamp, BASE_FRAME, *self._pose)
        self._publisher.publish(self._given)
        self._diagnostics.values["stamp"] = stamp

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if self._given and status.name.rsplit("/", 1)[-1] == "episode":
                values = {pair.key: pair.value for pair in status.values}
                held, own = values.get(GOAL, "none"), goal_text(self._given)
                self._is_taken |= held == own
                self._refused = values.get(REFUSED, "") if values.get(REFUSED, "").startswith(own) else ""
                self._episode = f"; its diagnostics: {status.message}, goal {held}"


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `goal`."""
    ends = [0]

    def spin(node: GoalNode, spinner: Spinner) -> None:
        ends[0] = INTERRUPTED  # until it has ended by itself
        ends[0] = node.give(spinner)

    return run(GoalNode, args, spin=spin) or ends[0]


if __name__ == "__main__":
    raise SystemExit(main())
