"""`post_contact`: at every policy tick of phase `post`, a target pose and joint gains."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from np_common.rotations import quaternion_from_matrix
from np_description.message_arrays import BadMessage, stamp_nanoseconds
from np_description.panda import BASE_FRAME
from np_description.phases import POST
from np_policy.action import PolicyError
from np_policy.contract import POST_CONTACT, weights_file
from np_policy.nodes.common import (
    GoalStream,
    StateStream,
    declare_settings,
    declare_weights,
    report_weights,
    subscribe_keypoints,
    use_one_thread,
)
from np_policy.policy import PostContactPolicy
from np_ros import qos
from np_ros.messages import gains_message, pose_message
from np_ros.node import Diagnostics, parameter, run
from np_ros.phases import phase_state

_KEPT = 8  # keypoints messages that wait for their tick


class PostContactNode(Node):
    """Pairs tick, keypoints and state of one stamp and runs the policy on them."""

    def __init__(self) -> None:
        super().__init__("post_contact")
        self._settings = declare_settings(self)
        folder = declare_weights(self)
        reobserve_after = parameter(
            self,
            "reobserve_after",
            5,
            "Ticks in a row without 6 usable keypoints after which the hand is drawn up, out of the camera's way; 0: never.",
            0,
            600,
        )
        file = weights_file(POST_CONTACT, self._settings.domain, folder)
        use_one_thread(file)
        self._policy = PostContactPolicy(
            file,
            self._settings.domain,
            min_score=self._settings.min_score,
            camera=self._settings.camera,
            policy_rate=self._settings.policy_rate,
            reobserve_after=reobserve_after,
        )
        self.diagnostics = Diagnostics(self)
        report_weights(self, self.diagnostics, self._policy.warnings)
        self._keypoints: OrderedDict[int, np.ndarray | None] = OrderedDict()
        self._phase = ""
        self._pending: int | None = None  # stamp of the tick whose target is due
        self._answer: tuple[int, Float64MultiArray, PoseStamped] | None = None  # stamp, gains, pose
        stream = qos.publisher(self._settings.lockstep)
        self._gains = self.create_publisher(Float64MultiArray, "target_gains", stream)
        self._pose = self.create_publisher(PoseStamped, "target_pose", stream)
        self._goal = GoalStream(self, self.diagnostics, self._act, self._forget)
        self.create_subscription(
            DiagnosticArray, "episode/tick", self._on_tick, qos.subscriber(self._settings.lockstep)
        )
        subscribe_keypoints(self, self.diagnostics, self._settings.lockstep, self._on_keypoints)
        self._state = StateStream(self, self.diagnostics, self._settings, self._act)

    def _forget(self) -> None:
        self._keypoints.clear()
        self._answer = self._pending = None
        self._state.forget()

    def _on_tick(self, tick: DiagnosticArray) -> None:
        try:
            stamp, phase = stamp_nanoseconds(tick.header.stamp), phase_state(tick).phase
        except BadMessage as error:
            return self.diagnostics.refuse(error.kind, error)
        if self._answer and self._answer[0] == stamp:
            return self._send()  # a repeated tick: the first reply was lost
        if phase == POST and self._phase != POST:
            self._policy.reset()
        self._phase = phase
        self._pending = stamp if self._phase == POST else None
        self._act()

    def _on_keypoints(self, stamp: int, keypoints: np.ndarray | None) -> None:
        self._keypoints[stamp] = keypoints
        while len(self._keypoints) > _KEPT:
            self._keypoints.popitem(last=False)
        self._act()

    def _act(self) -> None:
        stamp = self._pending
        if stamp is None or stamp not in self._keypoints or self._goal.keypoints is None or not self._state.has(stamp):
            return
        try:
            q, dq = self._state.arrays()
            self._pending = None
            target = self._policy.act(q, dq, self._keypoints[stamp], self._goal.keypoints)
        except BadMessage as error:
            return self.diagnostics.refuse(error.kind, error)
        except PolicyError as error:
            self.get_logger().error(str(error), throttle_duration_sec=1.0)
            return self.diagnostics.count("refused_action")
        pose = pose_message(stamp, BASE_FRAME, target.position, quaternion_from_matrix(target.rotation))
        self._answer = stamp, gains_message(np.stack([target.stiffness, target.damping_ratio])), pose
        self.diagnostics.values["stamp"] = stamp
        self._send()

    def _send(self) -> None:
        """Gains first: the receiver pairs a pose with the newest gains before it."""
        _, gains, pose = self._answer
        self._gains.publish(gains)
        self._pose.publish(pose)


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `post_contact`."""
    return run(PostContactNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
