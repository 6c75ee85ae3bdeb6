"""What the four nodes of this package share: parameters, streams that are kept until they are needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from sensor_msgs.msg import JointState, PointCloud2

from np_description.calibration import load_calibrated_view
from np_description.camera import Camera
from np_description.control_rate import SECOND
from np_description.domains import Task
from np_description.message_arrays import (
    BadMessage,
    joint_state_arrays,
    keypoints_array,
    stamp_nanoseconds,
)
from np_description.panda import STATE_NAMES
from np_policy import action
from np_ros import qos
from np_ros.low_latency.latest_message import LatestMessage
from np_ros.low_latency.raw import decode_raw, read_stamp
from np_ros.node import Diagnostics, declare_mode, parameter
from np_ros.task_domain import declare_domain

OLDEST_STATE = 200_000_000  # ns before the image; the clocks of a robot and a camera may be apart too


@dataclass(frozen=True)
class PolicySettings:
    """Parameters of every node here; policy_period ns; camera: the one that the keypoints are seen by, with
    the covariance (6, 6) of its pose, m and rad, where it was calibrated."""

    domain: Task
    lockstep: bool
    policy_period: int
    min_score: float
    camera: Camera
    camera_covariance: np.ndarray | None

    @property
    def policy_rate(self) -> float:
        """Policy ticks a second."""
        return SECOND / self.policy_period

    def is_policy_tick(self, stamp: int) -> bool:
        """Whether something may be decided at stamp ns: always in real time, at policy ticks in lockstep."""
        return not self.lockstep or stamp % self.policy_period == 0


def declare_settings(node: Node) -> PolicySettings:
    """Declare and read the parameters that every node of this package has. Raises CalibrationError for a bad file, ValueError
    for an object that is none of the domain's."""
    domain = declare_domain(node)
    mode = declare_mode(node)
    rate = parameter(node, "policy_rate", action.RATE, "Policy ticks a second; a divisor of 500.", 1, 500)
    score = parameter(node, "min_score", 0.3, "Score from which a keypoint is used.", 0.0, 1.0)
    calibration = parameter(
        node, "calibration", "", "File written by `calibrate`: where the camera is; empty: as trained."
    )
    return PolicySettings(domain, mode == "lockstep", SECOND // rate, score, *load_calibrated_view(calibration))


def declare_weights(node: Node) -> str:
    """Declare and read the parameter `weights`, a folder."""
    return parameter(node, "weights", "", "Folder with released weights; empty: $NP_WEIGHTS, or the project's own.")


def use_one_thread(file: Path) -> None:
    """Of PyTorch, where the weights in `file` need it: equal inputs give equal bits."""
    if file.suffix != ".onnx":
        import torch  # slow: no --help should wait for it

        torch.set_num_threads(1)


def report_weights(node: Node, diagnostics: Diagnostics, warnings: Sequence[str]) -> None:
    """Report in log and diagnostics how the weights differ from what runs here, where that is no refusal."""
    if warnings:
        node.get_logger().warn("; ".join(warnings))
        diagnostics.report(DiagnosticStatus.WARN, "; ".join(warnings))


def subscribe_keypoints(
    node: Node, diagnostics: Diagnostics, lockstep: bool, callback: Callable[[int, np.ndarray | None], None]
) -> None:
    """Call `callback` with stamp ns and keypoints (8, 3), or with None for keypoints that had to be refused."""

    def receive(message: PointCloud2) -> None:
        try:
            stamp = stamp_nanoseconds(message.header.stamp)
        except BadMessage as error:
            return diagnostics.refuse(error.kind, error)
        try:
            keypoints = keypoints_array(message)
        except BadMessage as error:
            diagnostics.refuse(error.kind, error)
            keypoints = None
        callback(stamp, keypoints)

    node.create_subscription(PointCloud2, "keypoints", receive, qos.subscriber(lockstep))


class GoalStream:
    """The goal keypoints in force: `stamp` ns and `keypoints` (8, 3), None before the first.

    Calls `callback` at every goal; before that `restart` where its stamp is before that of the last one: the backend was
    restarted alone, and its time begins anew.
    """

    def __init__(
        self, node: Node, diagnostics: Diagnostics, callback: Callable[[], None], restart: Callable[[], None]
    ) -> None:
        self._diagnostics, self._callback, self._restart = diagnostics, callback, restart
        self.stamp = -1
        self.keypoints: np.ndarray | None = None
        node.create_subscription(PointCloud2, "goal_keypoints", self._receive, qos.LATCHED)

    def _receive(self, message: PointCloud2) -> None:
        try:
            stamp, keypoints = stamp_nanoseconds(message.header.stamp), keypoints_array(message)
        except BadMessage as error:
            return self._diagnostics.refuse(error.kind, error)
        if stamp < self.stamp:
            self._restart()
        self.stamp, self.keypoints = stamp, keypoints
        self._callback()


class StateStream:
    """The joint state that decisions are made on: in lockstep that of the last policy tick, else the newest.

    States come 500 times a second and are needed ten times: only those are decoded, and in real time only those are taken.
    `stamp` is that of the last call of `has`.
    """

    def __init__(
        self, node: Node, diagnostics: Diagnostics, settings: PolicySettings, callback: Callable[[], None]
    ) -> None:
        self._node, self._diagnostics, self._settings, self._callback = node, diagnostics, settings, callback
        self._raw: bytes | None = None
        self.stamp = -1
        self._newest = None if settings.lockstep else LatestMessage(node, JointState, "joint_states")
        if settings.lockstep:
            node.create_subscription(JointState, "joint_states", self._receive, qos.LOCKSTEP, raw=True)

    def has(self, stamp: int) -> bool:
        """Whether a state is there to decide on about the image of stamp ns: its own, or, in real time, one hardly older."""
        if self._newest is None:
            return self.stamp == stamp
        if (raw := self._newest.take()) is not None:
            self._receive(raw)
        return self._raw is not None and self.stamp >= stamp - OLDEST_STATE

    def forget(self) -> None:
        """In real time: drop the newest state, which is of a backend before its restart; the next one counts."""
        if self._newest is not None:
            self._newest.take()
            self._raw, self.stamp = None, -1

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (9,) of joints and fingers: rad, m and per s. Raises BadMessage."""
        message = decode_raw(self._raw, JointState)
        return joint_state_arrays(message, STATE_NAMES)[:2]

    def _receive(self, raw: bytes) -> None:
        try:
            stamp = read_stamp(raw)
        except BadMessage as error:
            return self._diagnostics.refuse(error.kind, error)
        if self._settings.is_policy_tick(stamp):
            self._raw, self.stamp = raw, stamp
            if self._settings.lockstep:
                self._callback()
