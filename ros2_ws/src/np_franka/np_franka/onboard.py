"""The impedance controller inside the driver, which computes a command in every cycle of the robot
(`control:=onboard`). No ROS.

The same objects as in the node `joint_impedance`, at twice its rate. A silent policy has the effect here that a
silent controller has in `control:=topic`: no node stands between policy and driver."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from np_control.controller import Controller, ControllerConfig, ControllerOutput
from np_control.realtime_input import RealtimeCommandInput
from np_control.safety import Refusal, SafetyLimits
from np_control.trajectory import Trajectory
from np_description.phases import AT_REST


class Onboard:
    """Leads a `Controller` by what comes over topics, and computes the driver's commands.

    It is silent until it has been given something to follow. Then it has a command for every state, unless a
    target is overdue: from the first target until a trajectory, a new episode or the end of one, the next must
    come within `target_timeout_ns` by the driver's clock. `release` makes it silent again."""

    def __init__(self, config: ControllerConfig, limits: SafetyLimits, target_timeout_ns: int):
        self._controller = Controller(config, limits)
        self._following = RealtimeCommandInput(self._controller)
        self._timeout = target_timeout_ns
        self._newest_target = -1
        self.release()

    def release(self) -> None:
        """Forget what was followed: the arm is being stopped, or was."""
        self._controller.release()
        self._following.forget()
        self._thought: tuple[int, Generator[None, None, bool]] | None = None  # target that is being resolved
        self._is_engaged = False
        self._first: ControllerOutput | None = None
        self._due: int | None = None

    def answer(self, stamp: int, q: np.ndarray, dq: np.ndarray) -> ControllerOutput | None:
        """Joint target and torque for the state of `stamp` ns: q (7,) rad, dq (7,) rad/s; None while silent.

        Raises Refusal: not_finite, heartbeat.
        """
        self._following.check_owner()
        if self._controller.observe(stamp, q, dq):
            # A state the arm cannot have reached: what was followed is over.
            self._is_engaged, self._due, self._thought = False, None, None
            self._following.begin()
        if not self._is_engaged or (self._due is not None and stamp > self._due):
            return None
        if self._first is not None:
            first, self._first = self._first, None
            return first
        return self._controller.answer()

    def trajectory(self, trajectory: Trajectory | None) -> None:
        """Follow a plan from now on, or in phase pre from phase approach on; None changes nothing. Raises Refusal."""
        if trajectory is not None:
            first = self._controller.answer()
            if self._following.trajectory(trajectory):
                self._begin_plan(first)

    def gains(self, gains: np.ndarray | None) -> None:
        """Gains (2, 7), stiffness Nm/rad and damping ratio, for the pose that comes next."""
        self._following.gains(gains)

    def pose(self, stamp: int, pose: tuple[np.ndarray, np.ndarray] | None) -> None:
        """Move T_E to `pose`, position (3,) m and rotation (3, 3), with the gains that came since the last
        pose.

        stamp: ns of the state that it was computed from; None: a pose that was refused. It takes effect once
        `think` has found the joints for it; one that is still being resolved is dropped. Raises Refusal."""
        gains = self._following.take_gains(stamp)
        if pose is not None:
            self._thought = stamp, self._controller.resolve_target(stamp, *pose, *gains)
            self.think()

    def think(self) -> bool:
        """One step of what does not fit into one cycle. Whether a target has just been cut to the workspace.

        Raises Refusal, which drops the target.
        """
        if self._thought is None:
            return False
        stamp, resolving = self._thought
        first = self._controller.answer()
        try:
            next(resolving)
        except StopIteration as end:
            self._thought = None
            self._engage(first)
            if (
                stamp > self._newest_target and self._following.phase not in AT_REST
            ):  # the same again is no sign of life
                self._due = self._controller.stamp + self._timeout
            self._newest_target = max(stamp, self._newest_target)
            return end.value
        except Refusal:
            self._thought = None
            raise
        return False

    def phase(self, phase: str) -> None:
        """The phase of the episode: at its end the arm comes to rest and holds, and no target is due. Raises Refusal for a plan that waited."""
        first = self._controller.answer() if self._following.has_plan else None
        if self._following.enter(phase):
            self._begin_plan(first)
        if phase in AT_REST:
            self._due = self._thought = None

    def heartbeat(self, phase: str) -> None:
        """The owner of the phase still runs."""
        self._following.heartbeat(phase)

    def _begin_plan(self, first: ControllerOutput) -> None:
        self._engage(first)
        self._due = self._thought = None

    def _engage(self, first: ControllerOutput) -> None:
        """The first command is the measured posture, whatever is followed then."""
        if not self._is_engaged:
            self._is_engaged, self._first = True, first
