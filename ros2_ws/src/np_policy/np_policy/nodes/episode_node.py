"""`episode`: owns the phases. Messages in, to `np_policy.episode.Episode`, and what it decides out."""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from np_description.domains import Pose, check_goal
from np_description.message_arrays import BadMessage, pose_arrays, stamp_nanoseconds, trajectory_arrays
from np_description.panda import BASE_FRAME, JOINT_NAMES
from np_description.phases import ACTIVE, SUCCEEDED, PhaseState
from np_description.scene import CAMERA_NAME
from np_policy.episode import Episode, Event, Goal, InputRefusal, Tick
from np_policy.episode_config import EpisodeConfig
from np_policy.nodes.common import StateStream, declare_settings, subscribe_keypoints
from np_policy.sent_time import SentTime
from np_ros import qos
from np_ros.goals import GOAL, REFUSED, goal_text
from np_ros.messages import keypoints_message
from np_ros.node import Diagnostics, create_steady_timer, parameter, run
from np_ros.phases import PhasePublisher, refusal_reason

BACKEND_SILENCE = 3.0  # s of wall time; it reports every second
_HELP = {
    "settle": ("Rest between approach and post, s.", 0.0, 10.0),
    "pre_timeout": ("How long keypoints may be unusable in phase pre, s.", 0.0, 600.0),
    "post_timeout": ("Longest phase post, s.", 0.1, 3600.0),
    "post_blind": ("How long keypoints may be unusable in phase post, s.", 0.0, 600.0),
    "success_frames": ("Ticks in a row within the tolerance's share that make a success.", 1, 100),
    "success_share": ("Share of the domain's tolerance that the estimated pose has to be within.", 0.05, 1.0),
    "contacts": (
        "How often a contact may be chosen: when its time is over the hand lets go and looks again; paper: 1.",
        1,
        20,
    ),
    "planning": ("Wall time in which a trajectory must come, s.", 0.1, 3600.0),
    "arrival": ("Real time: rad that a joint may be off the plan's end when phase post begins.", 0.01, 3.0),
}


class EpisodeNode(Node):
    """Translates; decides nothing."""

    def __init__(self) -> None:
        super().__init__("episode")
        settings = declare_settings(self)
        self._domain = settings.domain
        defaults = EpisodeConfig(settings.domain, success_share=settings.domain.tolerance_fraction)
        values = {name: parameter(self, name, getattr(defaults, name), *described) for name, described in _HELP.items()}
        values["silence"] = parameter(
            self,
            "silence",
            0.0,
            "Wall time s in which keypoints must come; 0: 2 s in real time, 30 s in lockstep, where slow is no fault.",
            0.0,
            3600.0,
        ) or (30.0 if settings.lockstep else 2.0)
        self._backend = parameter(self, "backend", "sim_bridge", "Name of the node whose diagnostics tell of a hold.")
        self.diagnostics = Diagnostics(self)
        # In lockstep time stands still for a plan, and its first state is the one it was made for.
        self._state = None if settings.lockstep else StateStream(self, self.diagnostics, settings, lambda: None)
        self._episode = Episode(
            EpisodeConfig(
                settings.domain,
                lockstep=settings.lockstep,
                policy_period=settings.policy_period,
                min_score=settings.min_score,
                camera=settings.camera,
                camera_covariance=settings.camera_covariance,
                **values,
            ),
            self._joints,
        )
        self._waits_for, self._waits_since = "", time.monotonic()
        self._backend_heard: float | None = None
        self._sent_time = SentTime()
        self._phases = PhasePublisher(self, lockstep=settings.lockstep)
        self._goal = self.create_publisher(PointCloud2, "goal_keypoints", qos.LATCHED)
        self.create_subscription(PoseStamped, "goal_pose", self._on_goal, qos.LATCHED)
        self.create_subscription(JointTrajectory, "joint_trajectory", self._on_trajectory, qos.EVENT)
        self.create_subscription(DiagnosticArray, "approach/refusal", self._on_refusal, qos.EVENT)
        self.create_subscription(DiagnosticArray, "diagnostics", self._on_diagnostics, qos.EVENT)
        subscribe_keypoints(self, self.diagnostics, settings.lockstep, self._on_keypoints)
        self.create_service(Trigger, "~/start", lambda _, response: self._serve(self._episode.start, response))
        self.create_service(Trigger, "~/stop", lambda _, response: self._serve(self._episode.stop, response))
        # Its response comes at the episode's end: no other service may wait for it.
        self._ends: list[Future] = []
        self.create_service(Trigger, "~/run", self._run, callback_group=ReentrantCallbackGroup())
        create_steady_timer(self, 0.1, self._on_timer)
        self._publish([PhaseState(self._episode.phase)])

    def _on_goal(self, message: PoseStamped, info: dict) -> None:
        try:
            pose = Pose(*pose_arrays(message, BASE_FRAME))
            check_goal(self._domain, pose)
            sent = self._sent_time.steady(info["source_timestamp"])
            events = self._episode.goal(stamp_nanoseconds(message.header.stamp), pose, sent)
        except InputRefusal as error:
            return self.diagnostics.refuse("order", error)
        except ValueError as error:
            self._episode.refuse_goal(str(error))
            self.diagnostics.refuse(error.kind if isinstance(error, BadMessage) else "range", error)
            self.diagnostics.values[REFUSED] = f"{goal_text(message)}: {error}"
            return self.diagnostics.publish()  # who gave it waits for this
        self._publish(events)
        self.diagnostics.values[GOAL] = goal_text(message)
        self.diagnostics.publish()  # who gave it waits for this

    def _on_keypoints(self, stamp: int, keypoints: np.ndarray | None) -> None:
        if self._waits_for == "keypoints":
            self._waits_since = time.monotonic()
        self._publish(self._episode.keypoints(stamp, keypoints))

    def _on_trajectory(self, message: JointTrajectory) -> None:
        def read() -> list[Event]:
            times, positions, _ = trajectory_arrays(message, JOINT_NAMES)
            stamp = stamp_nanoseconds(message.header.stamp)
            if not len(times):  # of a planner that gives no reason
                return self._episode.refusal(stamp)
            return self._episode.trajectory(stamp, float(times[-1]), positions[-1])

        self._plan(read)

    def _on_refusal(self, message: DiagnosticArray) -> None:
        self._plan(lambda: self._episode.refusal(stamp_nanoseconds(message.header.stamp), refusal_reason(message)))

    def _plan(self, read: Callable[[], list[Event]]) -> None:
        try:
            events = read()
        except BadMessage as error:
            return self.diagnostics.refuse(error.kind, error)
        except InputRefusal as error:
            return self.diagnostics.refuse("order", error)
        self._publish(events)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.rsplit("/", 1)[-1] == self._backend:
                self._backend_heard = time.monotonic()
                failed = status.level == DiagnosticStatus.ERROR
                self._publish(self._episode.backend(status.message if failed else ""))

    def _on_timer(self) -> None:
        now = time.monotonic()
        self._publish(self._episode.overdue(now - self._waits_since))
        if self._state and self._backend_heard is not None and now - self._backend_heard > BACKEND_SILENCE:
            self._publish(self._episode.backend_lost(f"no diagnostics of {self._backend} within {BACKEND_SILENCE:g} s"))

    def _joints(self) -> np.ndarray | None:
        if self._state is None or not self._state.has(0):
            return None
        try:
            return self._state.arrays()[0][: len(JOINT_NAMES)]
        except BadMessage as error:
            self.diagnostics.refuse(error.kind, error)
            return None

    def _serve(self, action, response: Trigger.Response) -> Trigger.Response:
        try:
            self._publish(action())
            response.success, response.message = True, self._episode.phase
        except InputRefusal as error:
            response.success, response.message = False, str(error)
        return response

    async def _run(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """As `start`, with the response at the episode's end."""
        future = Future()
        self._ends.append(future)
        if not self._serve(self._episode.start, response).success:
            self._ends.remove(future)
            return response
        end: PhaseState = await future
        response.success = end.phase == SUCCEEDED
        outcome = {"phase": end.phase, "reason": end.reason}
        if np.isfinite([self._episode.distance, self._episode.angle]).all():
            outcome |= {"distance_m": round(self._episode.distance, 4), "angle_rad": round(self._episode.angle, 4)}
            outcome |= {"position_bound_m": round(self._episode.position_bound, 4)}
            outcome |= {"angle_bound_rad": round(self._episode.angle_bound, 4)}
        response.message = json.dumps(outcome)
        return response

    def _publish(self, events: list[Event]) -> None:
        for event in events:
            match event:
                case PhaseState():
                    self._phases.phase(event)
                    self.get_logger().info(str(event))
                    while self._ends and event.phase not in ACTIVE:
                        self._ends.pop().set_result(event)
                case Tick():
                    self._phases.tick(event.stamp, PhaseState(event.phase))
                case Goal():
                    self._goal.publish(keypoints_message(event.stamp, CAMERA_NAME, event.keypoints))
        if self._episode.awaits != self._waits_for:
            self._waits_for, self._waits_since = self._episode.awaits, time.monotonic()
        self.diagnostics.values.update(
            phase=self._episode.phase,
            waits_for=self._waits_for,
            distance=f"{self._episode.distance:.4f}",
            angle=f"{self._episode.angle:.4f}",
            position_bound=f"{self._episode.position_bound:.4f}",
            angle_bound=f"{self._episode.angle_bound:.4f}",
        )


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `episode`."""
    return run(EpisodeNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
