"""Standard messages to arrays and back, checked on the way in.

Every reader raises `BadMessage`, a ValueError that says what was expected and what came, and whose `kind`
is a short word to count by. A node that catches it refuses the message and goes on. Stamps are integers of
nanoseconds. Quaternions are wxyz on the array side and xyzw in the message, converted by
np_description.rotations.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2, PointField
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from np_description.calibration import Lens
from np_description.camera import Camera
from np_description.keypoints import COUNT
from np_description.rotations import wxyz_from_xyzw, xyzw_from_wxyz

NANOSECONDS = 1_000_000_000
Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]
KEYPOINT_FIELDS = ("u", "v", "score")
_KEYPOINT_STEP = 4 * len(KEYPOINT_FIELDS)
FARTHEST_PIXEL = 1e5  # px; where a hidden corner projects to may be far outside of an image
_UNIT_TOLERANCE = 1e-3


class BadMessage(ValueError):
    """A message that breaks docs/reference/graph.md.

    `kind` is one of stamp, names, shape, finite, range, frame, encoding.
    """

    def __init__(self, kind: str, text: str):
        super().__init__(kind, text)
        self.kind = kind

    def __str__(self) -> str:
        return self.args[1]


def _finite(values: np.ndarray, what: str) -> np.ndarray:
    if not np.isfinite(values).all():
        raise BadMessage("finite", f"{what}: expected finite numbers, got {values.tolist()}")
    return values


def _shaped(values, shape: tuple[int, ...], what: str) -> np.ndarray:
    result = np.asarray(values, dtype=np.float64)
    if result.shape != shape:
        raise BadMessage("shape", f"{what}: expected shape {shape}, got {result.shape}")
    return result


def _named(got: Sequence[str], names: Sequence[str], what: str) -> None:
    if list(got) != list(names):
        raise BadMessage("names", f"{what}: expected the names {list(names)} in this order, got {list(got)}")


def _doubles(values: np.ndarray) -> array:
    # The message's own storage type: it is taken over without a check of every element.
    return array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())


def stamp_message(nanoseconds: int) -> Time:
    """builtin_interfaces/Time of an integer of nanoseconds, 0 .. 2^31 s."""
    seconds, rest = divmod(int(nanoseconds), NANOSECONDS)
    if not 0 <= seconds < 2**31:
        raise ValueError(f"stamp: expected 0 .. 2^31 s in nanoseconds, got {nanoseconds}")
    return Time(sec=seconds, nanosec=rest)


def stamp_nanoseconds(stamp: Time) -> int:
    """Integer nanoseconds of a builtin_interfaces/Time."""
    if stamp.sec < 0 or not 0 <= stamp.nanosec < NANOSECONDS:
        raise BadMessage(
            "stamp",
            f"stamp: expected sec >= 0 and nanosec in 0 .. 999999999, got sec {stamp.sec}, nanosec {stamp.nanosec}",
        )
    return stamp.sec * NANOSECONDS + stamp.nanosec


def header_message(stamp: int, frame_id: str = "") -> Header:
    """std_msgs/Header."""
    return Header(stamp=stamp_message(stamp), frame_id=frame_id)


def serialized(message: object) -> bytes:
    """The CDR bytes of a message, as a bag keeps them."""
    return serialize_message(message)


def joint_state_message(stamp: int, names: Sequence[str], position, velocity, effort) -> JointState:
    """sensor_msgs/JointState of n joints: position (n,) rad or m, velocity (n,), effort (n,) Nm or N.

    All three arrays are required: tools refuse messages that end in an empty array.
    """
    shape = (len(names),)
    parts = [
        _shaped(values, shape, what)
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
            setattr(message, what, _doubles(_shaped(values, self._shape, what)))
        return message


def joint_state_arrays(message: JointState, names: Sequence[str]) -> Arrays:
    """(position, velocity, effort), each (n,), of a JointState with exactly these names in this order."""
    _named(message.name, names, "JointState.name")
    shape = (len(names),)
    return tuple(
        _finite(_shaped(getattr(message, part), shape, f"JointState.{part}"), f"JointState.{part}")
        for part in ("position", "velocity", "effort")
    )


def pose_message(stamp: int, frame_id: str, position, quaternion) -> PoseStamped:
    """geometry_msgs/PoseStamped of position (3,) m and unit quaternion (4,) wxyz in `frame_id`."""
    x, y, z = _shaped(position, (3,), "position").tolist()
    qx, qy, qz, qw = xyzw_from_wxyz(_shaped(quaternion, (4,), "quaternion")).tolist()
    pose = Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
    return PoseStamped(header=header_message(stamp, frame_id), pose=pose)


def pose_arrays(message: PoseStamped, frame_id: str) -> tuple[np.ndarray, np.ndarray]:
    """(position (3,) m, quaternion (4,) wxyz) of a PoseStamped that must be given in `frame_id`."""
    if message.header.frame_id != frame_id:
        raise BadMessage(
            "frame", f"PoseStamped.header.frame_id: expected '{frame_id}', got '{message.header.frame_id}'"
        )
    p, q = message.pose.position, message.pose.orientation
    position = _finite(np.array([p.x, p.y, p.z]), "PoseStamped.pose.position")
    xyzw = _finite(np.array([q.x, q.y, q.z, q.w]), "PoseStamped.pose.orientation")
    norm = float(np.linalg.norm(xyzw))
    if abs(norm - 1) > _UNIT_TOLERANCE:
        raise BadMessage(
            "range", f"PoseStamped.pose.orientation: expected norm 1 within {_UNIT_TOLERANCE}, got {norm:.6g}"
        )
    return position, wxyz_from_xyzw(xyzw)


def trajectory_message(stamp: int, names: Sequence[str], times, positions, velocities) -> JointTrajectory:
    """trajectory_msgs/JointTrajectory of n points.

    times (n,) s from the start, positions (n, joints) rad, velocities (n, joints) rad/s.
    """
    times = np.asarray(times, dtype=np.float64)
    shape = (times.size, len(names))
    positions, velocities = _shaped(positions, shape, "positions"), _shaped(velocities, shape, "velocities")
    message = JointTrajectory(header=header_message(stamp), joint_names=list(names))
    for time, position, velocity in zip(times.tolist(), positions, velocities):
        seconds, rest = divmod(round(time * NANOSECONDS), NANOSECONDS)
        point = JointTrajectoryPoint(time_from_start=Duration(sec=seconds, nanosec=rest))
        point.positions, point.velocities = _doubles(position), _doubles(velocity)
        point.accelerations = point.effort = _doubles(np.zeros(len(names)))  # readers of bags refuse empty arrays
        message.points.append(point)
    return message


def trajectory_arrays(message: JointTrajectory, names: Sequence[str]) -> Arrays:
    """(times (n,) s, positions (n, joints), velocities (n, joints)); times are not negative and increase."""
    _named(message.joint_names, names, "JointTrajectory.joint_names")
    durations = [point.time_from_start for point in message.points]
    times = np.array([d.sec * NANOSECONDS + d.nanosec for d in durations], dtype=np.int64)
    if times.size and (times[0] < 0 or (np.diff(times) <= 0).any()):
        raise BadMessage(
            "stamp", f"JointTrajectory: expected time_from_start >= 0 and increasing, got {times.tolist()} ns"
        )
    shape = (len(names),)
    tables = []
    for part in ("positions", "velocities"):
        what = f"JointTrajectory.points.{part}"
        rows = [_shaped(getattr(point, part), shape, what) for point in message.points]
        tables.append(_finite(np.array(rows, dtype=np.float64).reshape(times.size, *shape), what))
    return times / NANOSECONDS, *tables


def gains_message(gains) -> Float64MultiArray:
    """std_msgs/Float64MultiArray of gains (2, 7): stiffness Nm/rad in row 0, damping ratio rho in row 1."""
    gains = _shaped(gains, (2, 7), "gains")
    layout = MultiArrayLayout(
        dim=[MultiArrayDimension(label="gain", size=2, stride=14), MultiArrayDimension(label="joint", size=7, stride=7)]
    )
    message = Float64MultiArray(layout=layout)
    message.data = _doubles(gains)
    return message


def gains_array(message: Float64MultiArray) -> np.ndarray:
    """Gains (2, 7) of a Float64MultiArray labelled "gain" x "joint"."""
    dims = [(d.label, d.size) for d in message.layout.dim]
    if dims != [("gain", 2), ("joint", 7)] or message.layout.data_offset or len(message.data) != 14:
        raise BadMessage(
            "shape",
            "Float64MultiArray: expected dims gain 2 x joint 7, offset 0, 14 numbers, "
            f"got {dims}, {message.layout.data_offset}, {len(message.data)}",
        )
    return _finite(np.array(message.data, dtype=np.float64).reshape(2, 7), "Float64MultiArray.data")


def keypoints_message(stamp: int, frame_id: str, keypoints) -> PointCloud2:
    """sensor_msgs/PointCloud2 of keypoints (8, 3): u px, v px, score 0..1, stored as float32.

    The order is that of np_description.keypoints.
    """
    keypoints = _shaped(keypoints, (COUNT, 3), "keypoints")
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
        point_step=_KEYPOINT_STEP,
        row_step=_KEYPOINT_STEP * COUNT,
        is_dense=True,
    )
    message.data = array("B", keypoints.astype("<f4").tobytes())
    return message


def keypoints_array(message: PointCloud2) -> np.ndarray:
    """Keypoints (8, 3) float64: u px, v px, score 0..1, in the layout of `keypoints_message` only."""
    fields = [(f.name, f.offset, f.datatype, f.count) for f in message.fields]
    expected = [(name, 4 * i, PointField.FLOAT32, 1) for i, name in enumerate(KEYPOINT_FIELDS)]
    if fields != expected or message.is_bigendian:
        raise BadMessage(
            "encoding",
            "PointCloud2.fields: expected little-endian (name, offset, datatype, "
            f"count) {expected}, got {fields}, bigendian {message.is_bigendian}",
        )
    size = _KEYPOINT_STEP * COUNT
    wanted = (1, COUNT, _KEYPOINT_STEP, size)
    layout = (message.height, message.width, message.point_step, len(message.data))
    if layout != wanted:
        raise BadMessage("shape", f"PointCloud2: expected height, width, point_step, bytes {wanted}, got {layout}")
    keypoints = np.frombuffer(message.data, dtype="<f4").astype(np.float64).reshape(COUNT, 3)
    _finite(keypoints, "PointCloud2 keypoints")
    if (np.abs(keypoints[:, :2]) > FARTHEST_PIXEL).any():
        raise BadMessage(
            "range", f"PointCloud2 pixels: expected within {FARTHEST_PIXEL:g} px, got {keypoints[:, :2].tolist()}"
        )
    if not ((keypoints[:, 2] >= 0) & (keypoints[:, 2] <= 1)).all():
        raise BadMessage("range", f"PointCloud2 scores: expected 0 .. 1, got {keypoints[:, 2].tolist()}")
    return keypoints


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


def image_array(message: Image) -> np.ndarray:
    """Pixels (height, width, 3) uint8 of an rgb8 Image; rows may be padded. Read-only view of the message."""
    if message.encoding != "rgb8":
        raise BadMessage("encoding", f"Image.encoding: expected 'rgb8', got '{message.encoding}'")
    height, width, step = message.height, message.width, message.step
    if step < 3 * width or len(message.data) != step * height or not height * width:
        raise BadMessage(
            "shape",
            "Image: expected step >= 3 x width and step x height bytes, "
            f"got {height} x {width}, step {step}, {len(message.data)} bytes",
        )
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(height, step)
    pixels = rows[:, : 3 * width].reshape(height, width, 3)
    pixels.setflags(write=False)
    return pixels


def camera_info_message(stamp: int, frame_id: str, camera: Camera, turn=None) -> CameraInfo:
    """sensor_msgs/CameraInfo of an undistorted pinhole camera.

    turn (3, 3): rotation from the real camera's own optical frame to that of the images, where they were turned.
    """
    k = camera.matrix
    r = np.eye(3) if turn is None else _shaped(turn, (3, 3), "turn")
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


def camera_info_arrays(message: CameraInfo) -> tuple[int, int, np.ndarray]:
    """(width px, height px, K (3, 3)) of a CameraInfo without distortion."""
    if any(message.d):
        raise BadMessage("range", f"CameraInfo.d: expected no distortion (rectified images), got {list(message.d)}")
    return message.width, message.height, _finite(np.array(message.k).reshape(3, 3), "CameraInfo.k")


def camera_info_lens(message: CameraInfo) -> tuple[Lens, np.ndarray]:
    """Lens of the images that come with a CameraInfo, and the rotation (3, 3) by which they were turned already."""
    k = _finite(np.array(message.k, dtype=np.float64).reshape(3, 3), "CameraInfo.k")
    r = _finite(np.array(message.r, dtype=np.float64).reshape(3, 3), "CameraInfo.r")
    d = _finite(np.array(message.d, dtype=np.float64), "CameraInfo.d")
    if d.any() and (message.distortion_model != "plumb_bob" or len(d) != 5):
        raise BadMessage(
            "range",
            f"CameraInfo: expected plumb_bob with 5 coefficients, got '{message.distortion_model}' with {len(d)}",
        )
    if not np.allclose(r @ r.T, np.eye(3), rtol=0, atol=1e-6) or np.linalg.det(r) < 0:
        raise BadMessage("range", f"CameraInfo.r: expected a rotation, got {r.tolist()}")
    distortion = tuple(d.tolist()) if d.any() else (0.0,) * 5
    try:
        return Lens(message.width, message.height, *k[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), distortion), r
    except ValueError as error:
        raise BadMessage("range", f"CameraInfo: {error}") from error
