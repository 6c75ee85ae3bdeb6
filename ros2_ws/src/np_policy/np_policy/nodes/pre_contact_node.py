"""`pre_contact`: keypoints and goal to the hand pose and finger opening before contact."""

from __future__ import annotations

import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from std_msgs.msg import Float64

from np_description.message_arrays import BadMessage
from np_description.panda import BASE_FRAME
from np_description.phases import PRE
from np_perception.pose_estimation import has_enough_keypoints
from np_policy.action import PolicyError
from np_policy.contract import PRE_CONTACT, weights_file
from np_policy.nodes.common import (
    GoalStream,
    declare_settings,
    declare_weights,
    report_weights,
    subscribe_keypoints,
    use_one_thread,
)
from np_policy.policy import PreContactPolicy
from np_ros import qos
from np_ros.client.connection_status import has_all_subscribers
from np_ros.messages import pose_message
from np_ros.node import Diagnostics, create_steady_timer, run
from np_ros.phases import phase_state

OLDEST_KEYPOINTS = 0.5  # s since they came, in real time


class PreContactNode(Node):
    """Publishes one hand pose for every new goal, and for every contact that is to be chosen anew.

    It uses the first good keypoints of phase `pre`, and publishes the pose again if the backend repeats those.
    """

    def __init__(self) -> None:
        super().__init__("pre_contact")
        self._settings = declare_settings(self)
        folder = declare_weights(self)
        file = weights_file(PRE_CONTACT, self._settings.domain, folder)
        use_one_thread(file)
        self._planner = PreContactPolicy(
            file,
            self._settings.domain,
            min_score=self._settings.min_score,
            camera=self._settings.camera,
            policy_rate=self._settings.policy_rate,
        )
        self.diagnostics = Diagnostics(self)
        report_weights(self, self.diagnostics, self._planner.warnings)
        self._answered = -1  # stamp of the last goal that a pose was published for
        self._answer: tuple[int, Float64, PoseStamped] | None = None  # stamp of its keypoints, and the messages
        self._keypoints: tuple[int, np.ndarray] | None = None
        self._arrived = 0.0  # s of wall time, of the newest keypoints
        self._in_phase = False
        self._since = 0  # stamp from which keypoints count, of a contact that is chosen anew
        self._gripper = self.create_publisher(Float64, "gripper_command", qos.EVENT)
        self._pose = self.create_publisher(PoseStamped, "pre_contact_pose", qos.EVENT)
        # First: of what waits, what was seen is taken before the start, which in real time forgets it.
        subscribe_keypoints(self, self.diagnostics, self._settings.lockstep, self._on_keypoints)
        self.create_subscription(DiagnosticArray, "episode/phase", self._on_phase, qos.LATCHED)
        self._goal = GoalStream(self, self.diagnostics, self._act, self._forget)
        create_steady_timer(self, 0.1, self._act)  # for poses that wait for their subscribers

    def _on_phase(self, message: DiagnosticArray) -> None:
        try:
            state = phase_state(message)
        except BadMessage as error:
            return self.diagnostics.refuse(error.kind, error)
        before, self._in_phase = self._in_phase, state.phase == PRE
        if self._in_phase:
            again, self._since = self._since, int(state.since or 0)
            if self._since > again:
                self._answered = -1
        if self._in_phase and not before and not self._settings.lockstep:
            self._keypoints, self._answered = (
                None,
                -1,
            )  # another episode, maybe with the same goal: what it is to see is to come
        self._act()

    def _forget(self) -> None:
        self._keypoints, self._answer, self._answered = None, None, -1

    def _on_keypoints(self, stamp: int, keypoints: np.ndarray | None) -> None:
        good = has_enough_keypoints(keypoints, self._settings.min_score)
        if not self._settings.is_policy_tick(stamp):
            return
        if self._in_phase and self._settings.lockstep and self._answer and self._answer[0] == stamp:
            return self._send()
        self._keypoints, self._arrived = (stamp, keypoints) if good else None, time.monotonic()
        self._act()

    def _act(self) -> None:
        if not self._in_phase or self._goal.keypoints is None or self._keypoints is None:
            return
        began, (stamp, keypoints) = self._goal.stamp, self._keypoints
        if began == self._answered or stamp < max(began, self._since) or not self._is_heard():
            return
        if not self._settings.lockstep and time.monotonic() - self._arrived > OLDEST_KEYPOINTS:
            return  # of a camera that sends nothing any more
        self._answered = began
        try:
            wanted = self._planner.propose(keypoints, self._goal.keypoints)
        except PolicyError as error:
            self.get_logger().error(str(error))
            return self.diagnostics.count("refused_action")
        pose = pose_message(stamp, BASE_FRAME, wanted.pose.position, wanted.pose.quaternion)
        self._answer = stamp, Float64(data=wanted.opening), pose
        self.diagnostics.values.update(stamp=stamp, opening=round(wanted.opening, 4))
        self._send()

    def _send(self) -> None:
        """The opening first: approach plans with the fingers as they will be."""
        _, opening, pose = self._answer
        self._gripper.publish(opening)
        self._pose.publish(pose)

    def _is_heard(self) -> bool:
        """Whether every subscriber would get what is published now: it is sent again only on a repeat."""
        found = {each.topic_name: each.get_subscription_count() for each in (self._gripper, self._pose)}
        return all(count > 0 and has_all_subscribers(self, topic, count) for topic, count in found.items())


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `pre_contact`."""
    return run(PreContactNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
