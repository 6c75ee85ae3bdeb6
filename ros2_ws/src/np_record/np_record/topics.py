"""The topics of docs/reference/graph.md as data, to record, replay or check the whole graph."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Topic:
    """One topic of the contract."""

    name: str
    """Its relative name."""
    type: str
    """Full message type."""
    stamped: bool = True
    """Whether the message begins with the acquisition time: a header, or clock."""
    latched: bool = False
    """Whether a late joiner gets the last message."""
    reproducible: bool = True
    """Whether it is equal in two lockstep runs with the same seed."""


TOPICS = (
    # Causal order: that in which messages of the same stamp follow from each other.
    Topic("clock", "rosgraph_msgs/msg/Clock"),
    Topic("joint_states", "sensor_msgs/msg/JointState"),
    Topic("external_wrench", "geometry_msgs/msg/WrenchStamped"),
    Topic("motor_states", "sensor_msgs/msg/JointState"),
    Topic("camera/image_raw", "sensor_msgs/msg/Image"),
    Topic("camera/camera_info", "sensor_msgs/msg/CameraInfo"),
    Topic("object_pose", "geometry_msgs/msg/PoseStamped"),
    Topic("goal_pose", "geometry_msgs/msg/PoseStamped", latched=True),
    Topic("goal_keypoints", "sensor_msgs/msg/PointCloud2", latched=True),
    Topic("keypoints", "sensor_msgs/msg/PointCloud2"),
    Topic("episode/phase", "diagnostic_msgs/msg/DiagnosticArray", stamped=False, latched=True),
    Topic("episode/heartbeat", "std_msgs/msg/String", stamped=False, reproducible=False),
    Topic("gripper_command", "std_msgs/msg/Float64", stamped=False),
    Topic("pre_contact_pose", "geometry_msgs/msg/PoseStamped"),
    Topic("joint_trajectory", "trajectory_msgs/msg/JointTrajectory"),
    Topic("approach/refusal", "diagnostic_msgs/msg/DiagnosticArray"),
    Topic("episode/tick", "diagnostic_msgs/msg/DiagnosticArray"),
    Topic("target_gains", "std_msgs/msg/Float64MultiArray", stamped=False),
    Topic("target_pose", "geometry_msgs/msg/PoseStamped"),
    Topic("effort_command", "sensor_msgs/msg/JointState"),
    Topic("applied_command", "sensor_msgs/msg/JointState"),
    # Header of the time of publishing, by the wall: what happened when, not what was computed from what.
    Topic("diagnostics", "diagnostic_msgs/msg/DiagnosticArray", stamped=False, reproducible=False),
)

FORMER = (
    Topic("phase", "std_msgs/msg/String", stamped=False, latched=True),
    Topic("tick", "std_msgs/msg/Header"),
)
"""What bags of before `episode/phase` and `episode/tick` have in their place: read, and recorded no more."""

BY_NAME = {topic.name: topic for topic in (*TOPICS, *FORMER)}
TIMELINE = BY_NAME["joint_states"]
RANK = {topic: number for number, topic in enumerate(TOPICS)}
"""Place of a topic in the causal order; a former one has that of the topic which has replaced it."""
RANK |= {former: RANK[BY_NAME[f"episode/{former.name}"]] for former in FORMER}
