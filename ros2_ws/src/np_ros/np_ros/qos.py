"""Quality of service: one profile for each kind of topic in docs/reference/graph.md.

Streams (states, images, keypoints, commands, targets, ticks) differ between the two modes. In lockstep
nothing may be skipped, because time waits for the reply to every message; in real time only the newest one
is worth having.
"""

from __future__ import annotations

from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy


def _keep_last(depth: int, reliable: bool = True, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE,
    )


LOCKSTEP = _keep_last(5000)
"""Streams in lockstep, both sides: reliable, and kept until every subscriber has them: a writer forgets what has arrived
everywhere, and the backend lets time go on only while it has (`np_ros.arrivals`)."""

REALTIME_PUBLISHER = _keep_last(1)
"""Streams in real time, sending side: newest only; reliable, so that a recorder may request it."""

REALTIME_SUBSCRIBER = _keep_last(1, reliable=False)
"""Streams in real time, receiving side: best effort, so that a lost sample never delays the next one."""

VIEWER = _keep_last(16, reliable=False)
"""A viewer's side of joint_states, on which arm and gripper may publish at once: the newest of each is kept."""

EVENT = _keep_last(10)
"""What is sent on change in either mode: gripper_command, pre_contact_pose, joint_trajectory, approach/refusal,
diagnostics."""

LATCHED = _keep_last(1, latched=True)
"""What a late joiner must still get: goal_pose, goal_keypoints, episode/phase."""

RECORDER = _keep_last(5000)
"""The recorder's side of every stream: ten seconds at 500 Hz, for a disk that stalls. More than Fast DDS's
`max_samples` of 5000 would never be acknowledged."""

RECORDER_LATCHED = _keep_last(100, latched=True)
"""The recorder's side of what is latched: each of several in a row."""


def publisher(lockstep: bool) -> QoSProfile:
    """The profile with which a stream is published."""
    return LOCKSTEP if lockstep else REALTIME_PUBLISHER


def subscriber(lockstep: bool) -> QoSProfile:
    """The profile with which a node of the control loop subscribes to a stream."""
    return LOCKSTEP if lockstep else REALTIME_SUBSCRIBER
