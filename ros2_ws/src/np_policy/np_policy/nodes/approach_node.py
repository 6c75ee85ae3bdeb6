"""`approach`: the pre-contact pose to a joint trajectory, or to the reason why there is none."""

from __future__ import annotations

import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory

from np_description.domains import Pose
from np_description.message_arrays import BadMessage, pose_arrays, stamp_nanoseconds
from np_description.panda import BASE_FRAME, FINGER_MAX, JOINT_NAMES
from np_perception.pose_estimation import PoseError, estimate_pose
from np_planning.approach import ApproachConfig, ApproachPlan, plan_approach
from np_planning.collision import CollisionModel
from np_planning.rrt import PlanningBudget, PlanningError
from np_policy.nodes.common import StateStream, declare_settings, subscribe_keypoints
from np_ros import qos
from np_ros.messages import trajectory_message
from np_ros.node import Diagnostics, parameter, run
from np_ros.phases import refusal_message

_REPEATED = 0.5  # s of wall time: backends repeat after 1 s


class ApproachNode(Node):
    """Plans once for every `pre_contact_pose`, when the opening, the keypoints and the state it needs are there.

    In lockstep a pose or a state that is repeated gets the same reply again: then the first one was lost.
    """

    def __init__(self) -> None:
        super().__init__("approach")
        self._settings = declare_settings(self)
        self._seed = parameter(
            self, "seed", 0, "Of the planner: equal seeds and inputs give equal plans.", 0, 2**31 - 1
        )
        first = parameter(
            self, "first_checks", 60_000, "Collision checks until a first path must be found.", 100, 10**7
        )
        improve = parameter(self, "improve_checks", 20_000, "Further checks for shorter paths.", 0, 10**7)
        seconds = parameter(self, "planning_time", 2.0, "Real time only: s of wall time for planning.", 0.05, 60.0)
        defaults = ApproachConfig()
        clearance = parameter(self, "clearance", 0.005, "Distance to everything on the way, m.", 0.0, 0.05)
        self._config = ApproachConfig(
            velocity=parameter(self, "velocity", defaults.velocity, "Share of the velocity limits.", 0.01, 0.75),
            acceleration=parameter(
                self, "acceleration", defaults.acceleration, "Share of the acceleration limits.", 0.01, 0.7
            ),
            budget=PlanningBudget(first, improve, None if self._settings.lockstep else seconds),
        )
        self._collision = CollisionModel(self._settings.domain, clearance=clearance)
        self.diagnostics = Diagnostics(self)
        self._wanted: tuple[int, Pose] | None = None
        self._opening: float | None = None  # as of the newest command that no plan has used
        self._keypoints: tuple[int, np.ndarray | None] = (-1, None)
        self._seen = -1  # stamp of the newest state
        self._answer: JointTrajectory | DiagnosticArray | None = None
        self._answered, self._answered_at = -1, 0.0  # stamp, and when by the wall clock
        self._trajectory = self.create_publisher(JointTrajectory, "joint_trajectory", qos.EVENT)
        self._refusal = self.create_publisher(DiagnosticArray, "approach/refusal", qos.EVENT)
        self.create_subscription(Float64, "gripper_command", self._on_gripper, qos.EVENT)
        self.create_subscription(PoseStamped, "pre_contact_pose", self._on_pose, qos.EVENT)
        subscribe_keypoints(self, self.diagnostics, self._settings.lockstep, self._on_keypoints)
        self._state = StateStream(self, self.diagnostics, self._settings, self._on_state)

    def _on_gripper(self, message: Float64) -> None:
        if not 0.0 <= message.data <= FINGER_MAX:
            return self.diagnostics.refuse(
                "range", f"gripper_command: expected 0 .. {FINGER_MAX} m, got {message.data}"
            )
        self._opening = message.data
        self._act()

    def _on_pose(self, message: PoseStamped) -> None:
        try:
            stamp = stamp_nanoseconds(message.header.stamp)
        except BadMessage as error:
            return self.diagnostics.refuse(error.kind, error)
        try:
            pose = Pose(*pose_arrays(message, BASE_FRAME))
        except BadMessage as error:
            self.diagnostics.refuse(error.kind, error)
            return self._publish_failure(stamp, str(error))
        if stamp == self._answered and self._settings.lockstep:
            self._opening = None
            return self._repeat()
        self._wanted = stamp, pose
        self._act()

    def _on_state(self) -> None:
        if self._state.stamp < self._seen:
            self._answered = -1  # a backend that was restarted: its time begins anew
        self._seen = self._state.stamp
        if self._state.stamp == self._answered and self._settings.lockstep:
            self._repeat()
        self._act()

    def _on_keypoints(self, stamp: int, keypoints: np.ndarray | None) -> None:
        # While a plan is awaited its keypoints are kept.
        if keypoints is not None and (self._wanted is None or stamp <= self._wanted[0]):
            if stamp < self._keypoints[0]:
                self._state.forget()  # a backend that was restarted: its time begins anew
            self._keypoints = stamp, keypoints
        self._act()

    def _act(self) -> None:
        if self._wanted is None or self._opening is None:
            return
        stamp, pose = self._wanted
        seen, keypoints = self._keypoints
        if keypoints is None or (self._settings.lockstep and seen != stamp) or not self._state.has(stamp):
            return
        opening, self._wanted, self._opening = self._opening, None, None
        began = time.monotonic()
        try:
            joints = self._state.arrays()[0][:7]
            object_pose = estimate_pose(
                keypoints, self._settings.domain, min_score=self._settings.min_score, camera=self._settings.camera
            ).pose
            plan = plan_approach(
                self._collision, joints, pose, opening, object_pose, seed=self._seed, config=self._config
            )
        except BadMessage as error:
            self.diagnostics.refuse(error.kind, error)
            self._publish_failure(stamp, str(error))
        except (PoseError, PlanningError) as error:
            self._publish_failure(stamp, str(error))
        else:
            self._publish_plan(stamp, plan, time.monotonic() - began)

    def _publish_plan(self, stamp: int, plan: ApproachPlan, seconds: float) -> None:
        motion = plan.trajectory
        message = trajectory_message(stamp, JOINT_NAMES, motion.times, motion.positions, motion.velocities)
        message.header.frame_id = BASE_FRAME
        self._publish(stamp, message)
        self.diagnostics.values.update(
            planning_time=round(seconds, 3),
            duration=round(motion.duration, 3),
            lift=round(plan.lift, 4),
            drawn_out=round(plan.penetration_retreat, 4),
        )
        self.diagnostics.report(DiagnosticStatus.OK, "planned")

    def _publish_failure(self, stamp: int, reason: str) -> None:
        self.get_logger().error(reason)
        self._publish(stamp, refusal_message(stamp, reason))
        self.diagnostics.report(DiagnosticStatus.ERROR, reason)

    def _repeat(self) -> None:
        """Publish the reply again, unless it has just been: a repeat that came during planning has had it."""
        if time.monotonic() - self._answered_at > _REPEATED:
            self._say(self._answer)

    def _publish(self, stamp: int, answer: JointTrajectory | DiagnosticArray) -> None:
        self._answer, self._answered = answer, stamp
        self._say(answer)

    def _say(self, answer: JointTrajectory | DiagnosticArray) -> None:
        self._answered_at = time.monotonic()
        (self._trajectory if isinstance(answer, JointTrajectory) else self._refusal).publish(answer)


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `approach`."""
    return run(ApproachNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
