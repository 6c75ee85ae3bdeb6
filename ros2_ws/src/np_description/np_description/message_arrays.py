"""Standard ROS messages to arrays, checked. No ROS is needed: a message read from a bag will do.

Every reader raises `BadMessage`, a ValueError that names what was expected and what came; its `kind` is a short word
to count by. Stamps are integers of nanoseconds. Quaternions are xyzw in messages and wxyz in arrays.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from np_common.rotations import wxyz_from_xyzw
from np_description.calibration import Lens
from np_description.control_rate import SECOND
from np_description.keypoints import COUNT

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]
KEYPOINT_FIELDS = ("u", "v", "score")
KEYPOINT_STEP = 4 * len(KEYPOINT_FIELDS)
FLOAT32 = 7
"""sensor_msgs/PointField.FLOAT32."""
TURNED_CAMERA = "camera_turned"
"""Frame of images that the camera node has turned to where the policies' camera looks; their camera_info.r is that rotation."""
FARTHEST_PIXEL = 1e5
"""px; a hidden corner may project far outside of an image."""
ENCODINGS: dict[str, tuple[int, int, str]] = {
    "rgb8": (3, 1, ""),
    "bgr8": (3, 1, "COLOR_BGR2RGB"),
    "rgba8": (4, 1, "COLOR_RGBA2RGB"),
    "bgra8": (4, 1, "COLOR_BGRA2RGB"),
    "mono8": (1, 1, "COLOR_GRAY2RGB"),
    "yuyv": (2, 2, "COLOR_YUV2RGB_YUYV"),
    "yuv422_yuy2": (2, 2, "COLOR_YUV2RGB_YUYV"),
    "uyvy": (2, 2, "COLOR_YUV2RGB_UYVY"),
    "yuv422": (2, 2, "COLOR_YUV2RGB_UYVY"),
    "bayer_rggb8": (1, 2, "COLOR_BayerRGGB2RGB"),
    "bayer_bggr8": (1, 2, "COLOR_BayerBGGR2RGB"),
    "bayer_gbrg8": (1, 2, "COLOR_BayerGBRG2RGB"),
    "bayer_grbg8": (1, 2, "COLOR_BayerGRBG2RGB"),
}
"""Encodings of sensor_msgs/Image that are read: bytes of a pixel, pixels of a cell, OpenCV's conversion to RGB."""
_COMPRESSED = re.compile(r"(jpe?g|png)|((rgb|bgr)a?8|mono8); (jpeg|png) compressed (bgr8|mono8)? *")
"""Without those whose pixels are not BGR within the picture ("compressed rgb8"), of 16 bits or of a Bayer mosaic."""
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


def check_finite(values: np.ndarray, what: str) -> np.ndarray:
    if not np.isfinite(values).all():
        raise BadMessage("finite", f"{what}: expected finite numbers, got {values.tolist()}")
    return values


def check_shape(values, shape: tuple[int, ...], what: str) -> np.ndarray:
    result = np.asarray(values, dtype=np.float64)
    if result.shape != shape:
        raise BadMessage("shape", f"{what}: expected shape {shape}, got {result.shape}")
    return result


def check_names(got: Sequence[str], names: Sequence[str], what: str) -> None:
    if list(got) != list(names):
        raise BadMessage("names", f"{what}: expected the names {list(names)} in this order, got {list(got)}")


def stamp_nanoseconds(stamp) -> int:
    """Integer nanoseconds of a builtin_interfaces/Time."""
    if stamp.sec < 0 or not 0 <= stamp.nanosec < SECOND:
        raise BadMessage(
            "stamp",
            f"stamp: expected sec >= 0 and nanosec in 0 .. 999999999, got sec {stamp.sec}, nanosec {stamp.nanosec}",
        )
    return stamp.sec * SECOND + stamp.nanosec


def joint_state_arrays(message, names: Sequence[str]) -> Arrays:
    """(position, velocity, effort), each (n,), of a JointState with exactly these names in this order."""
    check_names(message.name, names, "JointState.name")
    shape = (len(names),)
    return tuple(
        check_finite(check_shape(getattr(message, part), shape, f"JointState.{part}"), f"JointState.{part}")
        for part in ("position", "velocity", "effort")
    )


def pose_arrays(message, frame_id: str) -> tuple[np.ndarray, np.ndarray]:
    """(position (3,) m, quaternion (4,) wxyz) of a PoseStamped that must be given in `frame_id`."""
    if message.header.frame_id != frame_id:
        raise BadMessage(
            "frame", f"PoseStamped.header.frame_id: expected '{frame_id}', got '{message.header.frame_id}'"
        )
    p, q = message.pose.position, message.pose.orientation
    position = check_finite(np.array([p.x, p.y, p.z]), "PoseStamped.pose.position")
    xyzw = check_finite(np.array([q.x, q.y, q.z, q.w]), "PoseStamped.pose.orientation")
    norm = float(np.linalg.norm(xyzw))
    if abs(norm - 1) > _UNIT_TOLERANCE:
        raise BadMessage(
            "range", f"PoseStamped.pose.orientation: expected norm 1 within {_UNIT_TOLERANCE}, got {norm:.6g}"
        )
    return position, wxyz_from_xyzw(xyzw)


def wrench_array(message, frame_id: str) -> np.ndarray:
    """Force N and moment Nm (6,) of a WrenchStamped that must be given in `frame_id`."""
    if message.header.frame_id != frame_id:
        raise BadMessage(
            "frame", f"WrenchStamped.header.frame_id: expected '{frame_id}', got '{message.header.frame_id}'"
        )
    f, m = message.wrench.force, message.wrench.torque
    return check_finite(np.array([f.x, f.y, f.z, m.x, m.y, m.z]), "WrenchStamped.wrench")


def trajectory_arrays(message, names: Sequence[str]) -> Arrays:
    """(times (n,) s, positions (n, joints), velocities (n, joints)); times are not negative and increase."""
    check_names(message.joint_names, names, "JointTrajectory.joint_names")
    durations = [point.time_from_start for point in message.points]
    times = np.array([d.sec * SECOND + d.nanosec for d in durations], dtype=np.int64)
    if times.size and (times[0] < 0 or (np.diff(times) <= 0).any()):
        raise BadMessage(
            "stamp", f"JointTrajectory: expected time_from_start >= 0 and increasing, got {times.tolist()} ns"
        )
    shape = (len(names),)
    tables = []
    for part in ("positions", "velocities"):
        what = f"JointTrajectory.points.{part}"
        rows = [check_shape(getattr(point, part), shape, what) for point in message.points]
        tables.append(check_finite(np.array(rows, dtype=np.float64).reshape(times.size, *shape), what))
    return times / SECOND, *tables


def gains_array(message) -> np.ndarray:
    """Gains (2, 7) of a Float64MultiArray labelled "gain" x "joint"."""
    dims = [(d.label, d.size) for d in message.layout.dim]
    if dims != [("gain", 2), ("joint", 7)] or message.layout.data_offset or len(message.data) != 14:
        raise BadMessage(
            "shape",
            "Float64MultiArray: expected dims gain 2 x joint 7, offset 0, 14 numbers, "
            f"got {dims}, {message.layout.data_offset}, {len(message.data)}",
        )
    return check_finite(np.array(message.data, dtype=np.float64).reshape(2, 7), "Float64MultiArray.data")


def keypoints_array(message) -> np.ndarray:
    """Keypoints (8, 3) float64: u px, v px, score 0..1, in the layout of `keypoints_message` only."""
    fields = [(f.name, f.offset, f.datatype, f.count) for f in message.fields]
    expected = [(name, 4 * i, FLOAT32, 1) for i, name in enumerate(KEYPOINT_FIELDS)]
    if fields != expected or message.is_bigendian:
        raise BadMessage(
            "encoding",
            "PointCloud2.fields: expected little-endian (name, offset, datatype, "
            f"count) {expected}, got {fields}, bigendian {message.is_bigendian}",
        )
    size = KEYPOINT_STEP * COUNT
    wanted = (1, COUNT, KEYPOINT_STEP, size)
    layout = (message.height, message.width, message.point_step, len(message.data))
    if layout != wanted:
        raise BadMessage("shape", f"PointCloud2: expected height, width, point_step, bytes {wanted}, got {layout}")
    keypoints = np.frombuffer(message.data, dtype="<f4").astype(np.float64).reshape(COUNT, 3)
    check_finite(keypoints, "PointCloud2 keypoints")
    if (np.abs(keypoints[:, :2]) > FARTHEST_PIXEL).any():
        raise BadMessage(
            "range", f"PointCloud2 pixels: expected within {FARTHEST_PIXEL:g} px, got {keypoints[:, :2].tolist()}"
        )
    if not ((keypoints[:, 2] >= 0) & (keypoints[:, 2] <= 1)).all():
        raise BadMessage("range", f"PointCloud2 scores: expected 0 .. 1, got {keypoints[:, 2].tolist()}")
    return keypoints


def image_array(message) -> np.ndarray:
    """Pixels (height, width, 3) uint8 RGB of an Image in one of ENCODINGS; rows may be padded. Read-only.

    Grey is repeated in the three channels. YUV is that of BT.601 with luma 16 .. 235, as cameras and OpenCV have it.
    """
    if message.encoding not in ENCODINGS:
        raise BadMessage(
            "encoding", f"Image.encoding: expected one of {', '.join(ENCODINGS)}, got '{message.encoding}'"
        )
    depth, multiple, conversion = ENCODINGS[message.encoding]
    height, width, step = message.height, message.width, message.step
    if step < depth * width or len(message.data) != step * height or not height * width:
        raise BadMessage(
            "shape",
            f"Image: expected step >= {depth} x width and step x height bytes, "
            f"got {height} x {width}, step {step}, {len(message.data)} bytes",
        )
    if width % multiple or (depth == 1 and multiple > 1 and (height % multiple or min(height, width) < 4)):
        raise BadMessage("shape", f"Image: expected whole {message.encoding} cells, got {height} x {width} pixels")
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(height, step)
    pixels = rows[:, : depth * width].reshape(height, width, depth)
    if conversion:
        import cv2  # 0.2 s, which commands without images do not spend

        pixels = cv2.cvtColor(np.ascontiguousarray(pixels), getattr(cv2, conversion))
    pixels.setflags(write=False)
    return pixels


def decode_compressed_image(message) -> np.ndarray:
    """Pixels (height, width, 3) uint8 RGB of a CompressedImage: JPEG or PNG of 8 bits, as image_transport and cv_bridge write them."""
    if not _COMPRESSED.fullmatch(message.format):
        raise BadMessage(
            "encoding",
            "CompressedImage.format: expected jpeg or png of a colour or mono8 picture, such as "
            f"'rgb8; jpeg compressed bgr8', got '{message.format}'",
        )
    import cv2

    data = np.frombuffer(message.data, dtype=np.uint8)
    found = cv2.imdecode(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION) if data.size else None
    if found is None:
        raise BadMessage(
            "shape", f"CompressedImage.data: expected a whole picture, got {data.size} bytes that make none"
        )
    return cv2.cvtColor(found, cv2.COLOR_BGR2RGB)


def camera_info_arrays(message) -> tuple[int, int, np.ndarray]:
    """(width px, height px, K (3, 3)) of a CameraInfo without distortion."""
    lens, _ = camera_info_lens(message)
    if any(lens.distortion):
        raise BadMessage("range", f"CameraInfo.d: expected no distortion (rectified images), got {list(message.d)}")
    return lens.width, lens.height, lens.matrix


def camera_info_lens(message, is_turned: bool = False) -> tuple[Lens, np.ndarray]:
    """Lens of the images that come with a CameraInfo, and the rotation (3, 3) by which they were turned already.

    k and d describe image_raw; r is a stereo rectification that is not applied to it (sensor_msgs/CameraInfo). Only our camera node
    turns its images by r: in the frame TURNED_CAMERA, or `is_turned` in recordings of before.
    """
    k = check_finite(np.array(message.k, dtype=np.float64).reshape(3, 3), "CameraInfo.k")
    r = check_finite(np.array(message.r, dtype=np.float64).reshape(3, 3), "CameraInfo.r")
    if not (k[[0, 1], [0, 1]] > 0).all() or (k[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] != (0, 0, 0, 0, 1)).any():
        raise BadMessage("range", f"CameraInfo.k: expected a calibrated camera without skew, got {k.tolist()}")
    roi, whole = message.roi, (0, 0, message.width, message.height)
    cut = (roi.x_offset, roi.y_offset, roi.width or message.width, roi.height or message.height)
    if max(message.binning_x, message.binning_y) > 1 or cut != whole:
        raise BadMessage(
            "range",
            f"CameraInfo: expected whole images, got binning {message.binning_x} x {message.binning_y}, roi (x, y, width, height) {cut}",
        )
    turn = np.eye(3)
    if is_turned or message.header.frame_id == TURNED_CAMERA:
        if not np.allclose(r @ r.T, np.eye(3), rtol=0, atol=1e-6) or np.linalg.det(r) < 0:
            raise BadMessage("range", f"CameraInfo.r: expected a rotation, got {r.tolist()}")
        turn = r
    try:
        return Lens(message.width, message.height, *k[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), _distortion(message)), turn
    except ValueError as error:
        raise error if isinstance(error, BadMessage) else BadMessage("range", f"CameraInfo: {error}") from error


def _distortion(message) -> tuple[float, ...]:
    """k1 k2 p1 p2 k3 of a CameraInfo. A fisheye without coefficients is no pinhole: the model is looked at in any case."""
    d, model = check_finite(np.array(message.d, dtype=np.float64), "CameraInfo.d"), message.distortion_model
    counts = {"plumb_bob": (0, 5), "rational_polynomial": (0, 8), "": (0, 5)}.get(model, ())
    if len(d) not in counts or d[5:].any() or (not model and d.any()):
        raise BadMessage(
            "range",
            f"CameraInfo: expected plumb_bob with 5 coefficients, got '{model}' with {len(d)}: {d.tolist()}",
        )
    return tuple(np.resize(d[:5], 5).tolist()) if d.any() else (0.0,) * 5
