"""The phases of an episode, as a state machine without clocks, threads or ROS.

Inputs are method calls with stamps; each returns what has to be published, in order. In lockstep decisions fall on policy
ticks only, whatever the wall clock does; it enters through `overdue` alone, which can only end an episode.
The contract is docs/reference/graph.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from np_description.control_rate import SECOND
from np_description.domains import Pose, is_lost, is_success, pose_error
from np_description.phases import ACTIVE, APPROACH, FAILED, FAULT, IDLE, POST, PRE, SUCCEEDED, PhaseState
from np_perception.pose_estimation import (
    FLOOR,
    LIES,
    MIN_POINTS,
    PoseError,
    check_resting,
    estimate_pose,
    has_enough_keypoints,
    project_keypoints,
)
from np_policy.episode_config import EpisodeConfig


@dataclass(frozen=True)
class Tick:
    """A policy tick: stamp ns and the phase in force from then on."""

    stamp: int
    phase: str


@dataclass(frozen=True)
class Goal:
    """Goal keypoints (8, 3) u px, v px, score 1, in force from stamp ns on."""

    stamp: int
    keypoints: np.ndarray


Event = PhaseState | Tick | Goal
"""What is to be published: the phase from now on, a tick, goal keypoints."""


class InputRefusal(ValueError):
    """An input that makes no sense now; the message gives the reason."""


class Episode:
    """The phases of one episode, from its start to success or failure.

    joints: called when the arm should have arrived; returns its joints (7,) rad, or None where they are unknown, which passes.
    """

    def __init__(self, config: EpisodeConfig, joints: Callable[[], np.ndarray | None] = lambda: None) -> None:
        self.config = config
        self._joints = joints
        self.phase = IDLE
        self.distance = self.angle = self.position_bound = self.angle_bound = float("nan")
        """Distance of the object's estimated pose from the goal, m and rad, and the bounds of the estimate, likewise; NaN where there is none."""
        self._goal: Goal | None = None
        self._goal_pose: Pose | None = None
        self._goal_sent = 0
        self._goal_refused = ""  # why the newest one was not taken
        self._goal_used = False
        self._fault = ""
        self._newest: tuple[int, np.ndarray | None] | None = None
        self._last_tick = -1
        self._forget()

    def _forget(self) -> None:
        self._begun = False  # whether the goal is in use
        self._planned_from: int | None = None  # stamp of the keypoints that a plan is awaited for
        self._motion_ends = self._post_began = 0
        self._not_before = -1  # stamp from which images count
        self._contact = 1
        self._rest_ends = -1  # stamp from which a contact is chosen
        self._plan_end: np.ndarray | None = None
        self._blind_since: int | None = None
        self._sure = self._near = self._seems = self._gone = 0

    @property
    def is_active(self) -> bool:
        """Whether an episode is under way."""
        return self.phase in ACTIVE

    def start(self) -> list[Event]:
        """Begin an episode with the newest goal. Raises InputRefusal while one is under way or the backend holds."""
        if self.is_active:
            raise InputRefusal(f"an episode is under way, in phase {self.phase}")
        if self._fault:
            raise InputRefusal(f"the backend reports: {self._fault}")
        if self._goal_refused:
            raise InputRefusal(f"the newest goal was refused, give another one: {self._goal_refused}")
        self._forget()
        self.distance = self.angle = self.position_bound = self.angle_bound = float("nan")
        self.phase = PRE
        events: list[Event] = [PhaseState(PRE)]
        if self.config.lockstep:
            return events + self._decide()
        # The same goal may be tried again. Nothing is decided on what was seen before, however long ago that was.
        self._goal_used = False
        self._not_before = -1 if self._newest is None else self._newest[0]
        return events

    def stop(self) -> list[Event]:
        """End the episode on request. Raises InputRefusal if there is none."""
        if not self.is_active:
            raise InputRefusal(f"no episode is under way, the phase is {self.phase}")
        return self._fail("stopped on request")

    def goal(self, stamp: int, pose: Pose, sent: int = 0) -> list[Event]:
        """A new task: the object's goal from stamp ns on; sent: when it was published, ns of a steady clock.

        Raises ValueError for a goal behind the camera, InputRefusal for one that was in force before the present one: what is
        latched comes when its publisher is found, which may be after a newer goal came.
        """
        goal = Goal(stamp, project_keypoints(self.config.domain, pose, self.config.camera))
        before = self._goal
        # Both: a backend that was restarted has earlier stamps, and another computer may have an earlier clock.
        if before and stamp <= before.stamp and sent < self._goal_sent:
            raise InputRefusal(f"a goal of {stamp} ns, sent before the one of {before.stamp} ns that is in force")
        self._goal_refused = ""
        if before and not self._goal_used and stamp == before.stamp and (goal.keypoints == before.keypoints).all():
            return []  # published twice
        # A backend that was restarted: its time begins anew. Its first goal may have been refused.
        if (before and stamp <= before.stamp) or (self._newest and stamp < self._newest[0]):
            self._newest, self._last_tick = None, -1
        ended = self._fail("the task was reset") if self.is_active and self._begun else []
        self._goal, self._goal_pose, self._goal_sent, self._goal_used = goal, pose, sent, False
        return [*ended, goal, *self._decide()]

    def refuse_goal(self, reason: str) -> None:
        """A new task could not be read, or is none of the domain's: no episode begins with the one before it."""
        self._goal_refused = reason

    def keypoints(self, stamp: int, keypoints: np.ndarray | None) -> list[Event]:
        """Keypoints (8, 3) of the image taken at stamp ns; None for a message that could not be read."""
        if self._newest is not None and stamp <= self._newest[0]:
            # The backend publishes a state again where a reply got lost; a second tick is harmless.
            is_repeated = self.config.lockstep and self.is_active and stamp == self._last_tick
            return [Tick(stamp, self.phase)] if is_repeated else []
        self._newest = stamp, keypoints
        return self._decide()

    def trajectory(self, stamp: int, duration: float, end: np.ndarray | None = None) -> list[Event]:
        """The plan for the keypoints of stamp ns: its duration s and, where it is known, last joints (7,) rad.

        Raises InputRefusal for a plan that is not awaited.
        """
        if self.phase == APPROACH and stamp == self._planned_from:
            return []  # published twice
        self._take_plan(stamp)
        self._plan_end = end
        begins = stamp if self.config.lockstep else self._newest[0]
        self._motion_ends = begins + round((duration + self.config.settle) * SECOND)
        return [PhaseState(APPROACH), *([self._tick(stamp)] if self.config.lockstep else [])]

    def refusal(self, stamp: int, reason: str = "") -> list[Event]:
        """There is no plan for the keypoints of stamp ns, and why. Raises InputRefusal where none is awaited."""
        self._take_plan(stamp)
        return self._fail(reason or "no plan")

    def _take_plan(self, stamp: int) -> None:
        """The planner's result for the keypoints of stamp ns begins the approach. Raises InputRefusal."""
        awaited = self._planned_from
        if (
            self.phase != PRE
            or awaited is None
            or not (
                stamp == awaited
                if self.config.lockstep
                else stamp >= max(self._goal.stamp, self._not_before, self._rest_ends)
            )
        ):
            raise InputRefusal(
                f"a plan for {stamp} ns, while the phase is {self.phase} and one is awaited for {awaited} ns"
            )
        self.phase = APPROACH

    def backend(self, fault: str) -> list[Event]:
        """What the backend reports: "" while it follows commands, else why it does not.

        A fault ends whatever phase there is; once it is over nothing is under way.
        """
        before, self._fault = self._fault, fault
        if fault and not before:
            self.phase = FAULT
            return [PhaseState(FAULT, fault)]
        if before and not fault and self.phase == FAULT:
            self.phase = IDLE
            return [PhaseState(IDLE)]
        return []

    def backend_lost(self, reason: str) -> list[Event]:
        """The backend publishes nothing any more: what comes back may be another arm, or the same one elsewhere."""
        return self._fail(reason) if self.is_active else []

    @property
    def awaits(self) -> str:
        """The topic without which the episode cannot go on, or "" if there is none under way."""
        if not self.is_active:
            return ""
        if not self._begun and (self._goal is None or self._goal_used):
            return "goal_pose"
        return "joint_trajectory" if self.phase == PRE and self._planned_from is not None else "keypoints"

    def overdue(self, waited: float) -> list[Event]:
        """End an episode that has been waiting for `awaits` for so many seconds by the wall clock, if that is too long."""
        topic = self.awaits
        limit = self.config.planning if topic == "joint_trajectory" else self.config.silence
        if not topic or waited <= limit:
            return []
        if topic == "joint_trajectory":
            self.phase = APPROACH  # nothing came from pre_contact or approach: where the episode got stuck
        return self._fail(f"no {topic} within {limit:g} s")

    def _decide(self) -> list[Event]:
        """What the newest keypoints mean."""
        if not self.is_active or self._newest is None or self._goal is None or (self._goal_used and not self._begun):
            return []
        stamp, keypoints = self._newest
        config = self.config
        due = (
            stamp % config.policy_period == 0
            if config.lockstep
            else stamp >= self._last_tick + 0.9 * config.policy_period or self._last_tick < 0
        )
        if stamp < max(self._goal.stamp, self._not_before) or stamp <= self._last_tick or not due:
            return []
        good = has_enough_keypoints(keypoints, config.min_score)
        if self.phase == PRE:
            return self._decide_pre(stamp, keypoints, good)
        events: list[Event] = []
        if self.phase == APPROACH and stamp >= self._motion_ends:
            if missed := self._missed():
                return self._fail(missed)
            self.phase, self._post_began, self._blind_since = POST, stamp, None
            events.append(PhaseState(POST))
        if self.phase == POST:
            end = self._judge(stamp, keypoints if good else None)
            if end:
                return events + end
        return [*events, self._tick(stamp)]

    def _decide_pre(self, stamp: int, keypoints, good: bool) -> list[Event]:
        self._goal_used = self._begun = True
        if stamp < self._rest_ends:
            return [self._tick(stamp)]
        if self._planned_from is None:
            if good:
                if leaning := self._leaning(keypoints):
                    return self._fail(leaning)
                self._planned_from = stamp
            elif self._blind_for(stamp) >= self.config.pre_timeout:
                return self._fail(f"fewer than {MIN_POINTS} usable keypoints for {self.config.pre_timeout:g} s")
        # In lockstep time stands still while the planner computes.
        return [] if good and self.config.lockstep else [self._tick(stamp)]

    def _judge(self, stamp: int, keypoints) -> list[Event]:
        """Success, failure, or neither, by the object's pose at a tick of phase post."""
        config = self.config
        try:
            if keypoints is None:
                raise PoseError(f"fewer than {MIN_POINTS} usable keypoints")
            # What is only slid lies, and is not tilted because corners behind the hand are found a little off.
            lies = 0.0 if config.domain.is_tumbled else LIES
            found = estimate_pose(
                keypoints,
                config.domain,
                min_score=config.min_score,
                camera=config.camera,
                floor=FLOOR,
                lies=lies,
                camera_covariance=config.camera_covariance,
            )
        except PoseError as error:
            self.distance = self.angle = self.position_bound = self.angle_bound = float("nan")
            self._sure = self._near = self._seems = 0
            if self._blind_for(stamp) >= config.post_blind:
                return self._end_contact(stamp, f"keypoints: {error} for {config.post_blind:g} s")
        else:
            self._blind_since = None
            pose, goal = found.pose, self._goal_pose
            self.distance, self.angle = map(
                float, pose_error(pose.position, pose.quaternion, goal.position, goal.quaternion)
            )
            self.position_bound, self.angle_bound = found.position_bound, found.angle_bound
            seems = is_success(config.domain, self.distance, self.angle)
            near = is_success(config.domain, self.distance + self.position_bound, self.angle + self.angle_bound)
            sure = near and is_success(config.domain, self.distance, self.angle, config.success_share)
            self._seems = self._seems + 1 if seems else 0
            self._near = self._near + 1 if near else 0
            self._sure = self._sure + 1 if sure else 0
            self._gone = self._gone + 1 if is_lost(config.domain, pose.position) else 0
            if (self._near if self._is_over(stamp) else self._sure) >= config.success_frames:
                self.phase = SUCCEEDED
                return [PhaseState(SUCCEEDED, **self._bounds)]
            if self._gone >= config.success_frames:
                return self._fail("the object left the workspace")
        return self._end_contact(stamp, self._late) if self._is_over(stamp) else []

    @property
    def _late(self) -> str:
        """What an episode has come to whose time is over."""
        if self._seems < self.config.success_frames:
            return "timeout"
        return (
            f"timeout: at the goal by an estimate that is too uncertain: {1e3 * self.position_bound:.1f} mm, "
            f"{np.degrees(self.angle_bound):.1f} degrees"
        )

    @property
    def _bounds(self) -> dict[str, str]:
        """The estimate's bounds as the message of an end has them; empty where there is no estimate."""
        bounds = {"position_bound": self.position_bound, "angle_bound": self.angle_bound}
        return {name: f"{bound:.4f}" for name, bound in bounds.items() if np.isfinite(bound)}

    def _end_contact(self, stamp: int, reason: str) -> list[Event]:
        """This contact comes to nothing, and why: the hand lets go, and once all is at rest another one is chosen, from where the object is
        now; or the episode fails, if it was the last."""
        if self._contact == self.config.contacts:
            return self._fail(reason)
        self._contact += 1
        self._rest_ends = stamp + round(self.config.settle * SECOND)
        self._planned_from = self._plan_end = self._blind_since = None
        self._sure = self._near = self._seems = self._gone = 0
        self.phase = PRE
        return [PhaseState(PRE, f"contact {self._contact}: {reason}", since=str(self._rest_ends)), self._tick(stamp)]

    def _leaning(self, keypoints) -> str:
        """How the object does not rest before the hand has touched it, or ""."""
        config = self.config
        if self._contact > 1:
            return ""
        try:
            check_resting(keypoints, config.domain, min_score=config.min_score, camera=config.camera)
        except PoseError as error:
            return str(error)
        return ""

    def _missed(self) -> str:
        """How the arm is not where the plan ends, as where its controller refused to follow it, or ""."""
        joints = self._joints()
        if joints is None or self._plan_end is None:
            return ""
        off = np.abs(joints - self._plan_end)
        worst = int(off.argmax())
        return (
            f"the arm did not arrive: joint {worst + 1} is {off[worst]:.2f} rad from the plan's end"
            if off[worst] > self.config.arrival
            else ""
        )

    def _is_over(self, stamp: int) -> bool:
        return stamp - self._post_began >= self.config.post_timeout * SECOND

    def _blind_for(self, stamp: int) -> float:
        """Seconds since keypoints became unusable, which they are at stamp ns."""
        self._blind_since = stamp if self._blind_since is None else self._blind_since
        return (stamp - self._blind_since) / SECOND

    def _tick(self, stamp: int) -> Tick:
        self._last_tick = stamp
        return Tick(stamp, self.phase)

    def _fail(self, reason: str) -> list[Event]:
        where, self.phase = self.phase, FAILED
        return [PhaseState(FAILED, f"{where}: {reason}", **self._bounds)]
