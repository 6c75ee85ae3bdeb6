"""`robot_state`: for RViz and Foxglove: the robot's description, the scene as markers, and /tf where its message type is installed."""

from __future__ import annotations

from functools import partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

from np_bringup.view.shown_joints import ShownJoints
from np_common.rotations import matrix_from_quaternion, quaternion_multiply
from np_description.domains import Pose
from np_description.drawing.robot import WORLD, urdf
from np_description.drawing.scene_data import SceneData
from np_description.message_arrays import BadMessage, pose_arrays
from np_description.panda import BASE_FRAME
from np_ros import qos
from np_ros.goals import episode_goal
from np_ros.low_latency.raw import decode_raw
from np_ros.messages import pose_message, stamp_message
from np_ros.node import Diagnostics, parameter, run
from np_ros.task_domain import declare_domain


def tf_message() -> type | None:
    """tf2_msgs/TFMessage, None where it is not installed: a whole ROS 2 has it, the wheels have not."""
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        return None
    return TFMessage


def compose_pose(outer, inner) -> tuple[np.ndarray, np.ndarray]:
    """The pose `inner` (7,) in the frame `outer` (7,), as position (3,) m and quaternion wxyz (4,) outside of it."""
    outer, inner = np.asarray(outer, float), np.asarray(inner, float)
    position = outer[:3] + matrix_from_quaternion(outer[3:]) @ inner[:3]
    return position, quaternion_multiply(outer[3:], inner[3:])


def markers(scene: dict, poses: list, stamp: int) -> MarkerArray:
    """A marker for each shape whose body has a pose, in the base frame; a capsule is a cylinder and two balls."""
    array = MarkerArray()
    for shape in scene["shapes"]:
        pose = poses[shape["body"]]
        if pose is None or shape["kind"] == "plane":
            continue
        if shape["kind"] == "box":
            parts = [(Marker.CUBE, [2 * s for s in shape["size"]], 0.0)]
        else:
            radius, half = shape["size"]
            ball = [2 * radius] * 3
            parts = [(Marker.CYLINDER, [2 * radius, 2 * radius, 2 * half], 0.0)]
            parts += [(Marker.SPHERE, ball, half), (Marker.SPHERE, ball, -half)]
        for kind, size, along in parts:
            inner = np.asarray(shape["pose"], float)
            inner[:3] += matrix_from_quaternion(inner[3:]) @ [0.0, 0.0, along]
            marker = Marker(type=kind, action=Marker.ADD, id=len(array.markers), ns="scene")
            marker.header.frame_id = BASE_FRAME
            marker.header.stamp = stamp_message(stamp)
            marker.pose = pose_message(stamp, BASE_FRAME, *compose_pose(pose, inner)).pose
            marker.scale.x, marker.scale.y, marker.scale.z = map(float, size)
            marker.color = ColorRGBA(**dict(zip("rgba", map(float, shape["rgba"]))))
            array.markers.append(marker)
    return array


def transforms(scene: dict, poses: list, stamp: int) -> list[TransformStamped]:
    """Transforms from the base to every other body with a known pose."""
    found = []
    for name, pose in zip(scene["bodies"], poses):
        if pose is None or name in (WORLD, BASE_FRAME):
            continue
        transform = TransformStamped(child_frame_id=name)
        transform.header.frame_id, transform.header.stamp = BASE_FRAME, stamp_message(stamp)
        to = transform.transform
        to.translation.x, to.translation.y, to.translation.z = map(float, pose[:3])
        to.rotation.w, to.rotation.x, to.rotation.y, to.rotation.z = map(float, pose[3:])
        found.append(transform)
    return found


class RobotState(Node):
    """Publishes at most `rate` times a second; a state in between is not looked at."""

    def __init__(self):
        super().__init__("robot_state")
        domain = declare_domain(self)
        rate = parameter(self, "rate", 20.0, "Scenes a second of wall time.", 0.5, 100.0)
        self._data = SceneData(
            domain, meshes=False
        )  # a hundred markers are small, meshes twenty times a second are not
        self._scene = self._data.scene()
        self._diagnostics = Diagnostics(self)
        self._joints = ShownJoints(partial(decode_raw, kind=JointState))
        self._pose: Pose | None = None
        self._goal: Pose | None = None
        self._episode_goal: Pose | None = None
        description = self.create_publisher(String, "robot_description", qos.LATCHED)
        description.publish(String(data=urdf()))
        self._markers = self.create_publisher(MarkerArray, "scene_markers", qos.REALTIME_PUBLISHER)
        kind = tf_message()
        self._tf = self.create_publisher(kind, "/tf", qos.RECORDER) if kind else None
        self._diagnostics.values["tf"] = "published" if kind else "tf2_msgs is not installed: markers only"
        stream = qos.REALTIME_SUBSCRIBER
        self.create_subscription(JointState, "joint_states", self._joints.add, qos.VIEWER, raw=True)
        self.create_subscription(PoseStamped, "object_pose", lambda m: self._read("_pose", m), stream)
        self.create_subscription(PoseStamped, "goal_pose", lambda m: self._read("_goal", m), qos.LATCHED)
        self.create_subscription(DiagnosticArray, "diagnostics", self._on_diagnostics, qos.EVENT)
        self.create_timer(1.0 / rate, self._show)

    def _read(self, name: str, message: PoseStamped) -> None:
        try:
            setattr(self, name, Pose(*pose_arrays(message, BASE_FRAME)))
        except BadMessage as error:
            self._diagnostics.refuse(error.kind, error)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self._episode_goal = episode_goal(message) or self._episode_goal

    def _show(self) -> None:
        if not self._joints:
            return
        try:
            stamp, joints = self._joints.read()
        except BadMessage as error:
            return self._diagnostics.refuse(error.kind, error)
        poses = self._data.poses(joints, self._pose, self._episode_goal or self._goal)
        self._markers.publish(markers(self._scene, poses, stamp))
        if self._tf is not None:
            self._tf.publish(self._tf.msg_type(transforms=transforms(self._scene, poses, stamp)))
        self._diagnostics.values["time"] = stamp / 1e9


def main(args: list[str] | None = None) -> int:
    """Entry point of the executable `robot_state`."""
    return run(RobotState, args)


if __name__ == "__main__":
    raise SystemExit(main())
