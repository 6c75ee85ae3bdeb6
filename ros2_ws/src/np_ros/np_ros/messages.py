"""Arrays to standard ROS messages; np_description.message_arrays reads them back.

Stamps are integers of nanoseconds. Quaternions are wxyz in arrays and xyzw in messages.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Vector3, Wrench, WrenchStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2, PointField
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from np_common.rotations import xyzw_from_wxyz
from np_description.camera import Camera
from np_description.control_rate import SECOND
from np_description.keypoints import COUNT
from np_description.message_arrays import (
    KEYPOINT_FIELDS,
    KEYPOINT_STEP,
    check_shape,
)


def _doubles(values: np.ndarray) -> array:
    # The message's own storage type: it is taken over without a check of every element.
    return array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())


def stamp_message(nanoseconds: int) -> Time:
    """builtin_interfaces/Time of an integer of nanoseconds, 0 .. 2^31 s."""
    seconds, rest = divmod(int(nanoseconds), SECOND)
    if not 0 <= seconds < 2**31:
        raise ValueError(f"stamp: expected 0 .. 2^31 s in nanoseconds, got {nanoseconds}")
    return Time(sec=seconds, nanosec=rest)


def header_message(stamp: int, frame_id: str = "") -> Header:
    """std_msgs/Header."""
    return Header(stamp=stamp_message(stamp), frame_id=frame_id)


def serialize(message: object) -> bytes:
    """The CDR bytes of a message, as a bag keeps them."""
    return serialize_message(message)


def joint_state_message(stamp: int, names: Sequence[str], position, velocity, effort) -> JointState:
    """sensor_msgs/JointState of n joints: position (n,) rad or m, velocity (n,), effort (n,) Nm or N.

    All three arrays are required: tools refuse messages that end in an empty array.
    """
    shape = (len(names),)
    parts = [
        check_shape(values, shape, what)
        for values, what in ((position, "position"), (velocity, "velocity"), (effort, "effort"))
    ]
    message = JointState(header=header_message(stamp), name=list(names))
    message.position, message.velocity, message.effort = map(_doubles, parts)
    return message


class JointStateWriter:
    """A JointState of the same joints over and over, for a stream: filled at a third of the cost of a new
    one. Publishing copies it, so that it may be filled again at once."""

    def __init__(self, names: Sequence[str]):
        self._message = joint_state_message(0, names, *np.zeros((3, len(names))))
        self._shape = (len(names),)

    def fill(self, stamp: int, position: np.ndarray, velocity: np.ndarray, effort: np.ndarray) -> JointState:
        """The message, with these contents: see `joint_state_message`."""
        message = self._message
        message.header.stamp = stamp_message(stamp)
        for what, values in (("position", position), ("velocity", velocity), ("effort", effort)):
            setattr(message, what, _doubles(check_shape(values, self._shape, what)))
        return message


def pose_message(stamp: int, frame_id: str, position, quaternion) -> PoseStamped:
    """geometry_msgs/PoseStamped of position (3,) m and unit quaternion (4,) wxyz in `frame_id`."""
    x, y, z = check_shape(position, (3,), "position").tolist()
    qx, qy, qz, qw = xyzw_from_wxyz(check_shape(quaternion, (4,), "quaternion")).tolist()
    pose = Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
    return PoseStamped(header=header_message(stamp, frame_id), pose=pose)


def wrench_message(stamp: int, frame_id: str, wrench) -> WrenchStamped:
    """geometry_msgs/WrenchStamped of a wrench (6,), force N then moment Nm, in the axes of `frame_id`."""
    fx, fy, fz, mx, my, mz = check_shape(wrench, (6,), "wrench").tolist()
    parts = Wrench(force=Vector3(x=fx, y=fy, z=fz), torque=Vector3(x=mx, y=my, z=mz))
    return WrenchStamped(header=header_message(stamp, frame_id), wrench=parts)


class WrenchWriter:
    """A WrenchStamped in the axes of `frame_id` over and over, as JointStateWriter."""

    def __init__(self, frame_id: str):
        self._message = wrench_message(0, frame_id, np.zeros(6))

    def fill(self, stamp: int, wrench: np.ndarray) -> WrenchStamped:
        """The message, with these contents: see `wrench_message`."""
        message = self._message
        message.header.stamp = stamp_message(stamp)
        force, moment = message.wrench.force, message.wrench.torque
        force.x, force.y, force.z, moment.x, moment.y, moment.z = check_shape(wrench, (6,), "wrench").tolist()
        return message


def trajectory_message(stamp: int, names: Sequence[str], times, positions, velocities) -> JointTrajectory:
    """trajectory_msgs/JointTrajectory of n points.

    times (n,) s from the start, positions (n, joints) rad, velocities (n, joints) rad/s.
    """
    times = np.asarray(times, dtype=np.float64)
    shape = (times.size, len(names))
    positions, velocities = check_shape(positions, shape, "positions"), check_shape(velocities, shape, "velocities")
    message = JointTrajectory(header=header_message(stamp), joint_names=list(names))
    for time, position, velocity in zip(times.tolist(), positions, velocities):
        seconds, rest = divmod(round(time * SECOND), SECOND)
        point = JointTrajectoryPoint(time_from_start=Duration(sec=seconds, nanosec=rest))
        point.positions, point.velocities = _doubles(position), _doubles(velocity)
        point.accelerations = point.effort = _doubles(np.zeros(len(names)))  # readers of bags refuse empty arrays
        message.points.append(point)
    return message


def gains_message(gains) -> Float64MultiArray:
    """std_msgs/Float64MultiArray of gains (2, 7): stiffness Nm/rad in row 0, damping ratio rho in row 1."""
    gains = check_shape(gains, (2, 7), "gains")
    layout = MultiArrayLayout(
        dim=[MultiArrayDimension(label="gain", size=2, stride=14), MultiArrayDimension(label="joint", size=7, stride=7)]
    )
    message = Float64MultiArray(layout=layout)
    message.data = _doubles(gains)
    return message


def keypoints_message(stamp: int, frame_id: str, keypoints) -> PointCloud2:
    """sensor_msgs/PointCloud2 of keypoints (8, 3): u px, v px, score 0..1, stored as float32.

    The order is that of np_description.keypoints.
    """
    keypoints = check_shape(keypoints, (COUNT, 3), "keypoints")
    fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate(KEYPOINT_FIELDS)
    ]
    message = PointCloud2(
        header=header_message(stamp, frame_id),
        height=1,
        width=COUNT,
        fields=fields,
        is_bigendian=False,
        point_step=KEYPOINT_STEP,
        row_step=KEYPOINT_STEP * COUNT,
        is_dense=True,
    )
    message.data = array("B", keypoints.astype("<f4").tobytes())
    return message


def image_message(stamp: int, frame_id: str, pixels: np.ndarray) -> Image:
    """sensor_msgs/Image rgb8 of pixels (height, width, 3) uint8."""
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] != 3:
        raise ValueError(f"pixels: expected (height, width, 3) uint8, got {pixels.shape} {pixels.dtype}")
    height, width = pixels.shape[:2]
    message = Image(
        header=header_message(stamp, frame_id),
        height=height,
        width=width,
        encoding="rgb8",
        is_bigendian=0,
        step=3 * width,
    )
    message.data = array("B", np.ascontiguousarray(pixels).tobytes())
    return message


def camera_info_message(stamp: int, frame_id: str, camera: Camera, turn=None) -> CameraInfo:
    """sensor_msgs/CameraInfo of an undistorted pinhole camera.

    turn (3, 3): rotation from the real camera's own optical frame to that of the images, where they were turned.
    """
    k = camera.matrix
    r = np.eye(3) if turn is None else check_shape(turn, (3, 3), "turn")
    return CameraInfo(
        header=header_message(stamp, frame_id),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=[0.0] * 5,
        k=k.ravel(),
        r=r.ravel(),
        p=np.hstack([k, np.zeros((3, 1))]).ravel(),
    )
