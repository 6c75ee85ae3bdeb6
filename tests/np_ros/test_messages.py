"""np_ros.messages: what goes out comes back, and what breaks the contract is refused by name."""

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import RegionOfInterest

from np_description import message_arrays
from np_description.camera import CAMERA
from np_description.message_arrays import BadMessage
from np_description.panda import BASE_FRAME, JOINT_NAMES, STATE_NAMES
from np_ros import messages
from np_ros.low_latency.raw import read_stamp

stamps = st.integers(0, 2**31 * 10**9 - 1)
doubles = st.floats(allow_nan=False, allow_infinity=False)


def sent(message):
    """The message as a receiver gets it."""
    return deserialize_message(serialize_message(message), type(message))


def vectors(*shape, low=None, high=None, dtype=np.float64, width=64):
    elements = st.floats(low, high, allow_nan=False, allow_infinity=False, width=width)
    return arrays(dtype, shape, elements=elements)


@given(stamps)
def test_stamp_round_trip(stamp):
    assert message_arrays.stamp_nanoseconds(sent(messages.stamp_message(stamp))) == stamp


@pytest.mark.parametrize("stamp", [-1, 2**31 * 10**9])
def test_stamp_outside_the_message_is_refused(stamp):
    with pytest.raises(ValueError, match="2\\^31"):
        messages.stamp_message(stamp)


@given(stamps, vectors(3, 9))
def test_joint_state_round_trip(stamp, values):
    message = sent(messages.joint_state_message(stamp, STATE_NAMES, *values))
    assert message_arrays.stamp_nanoseconds(message.header.stamp) == stamp
    np.testing.assert_array_equal(message_arrays.joint_state_arrays(message, STATE_NAMES), values)


@given(st.lists(st.tuples(stamps, vectors(3, 7)), min_size=1, max_size=4))
def test_a_message_filled_again_is_the_message_made_anew(contents):
    writer = messages.JointStateWriter(JOINT_NAMES)
    for stamp, values in contents:
        again = serialize_message(writer.fill(stamp, *values))
        assert again == serialize_message(messages.joint_state_message(stamp, JOINT_NAMES, *values))


@given(st.lists(st.tuples(stamps, vectors(6)), min_size=1, max_size=4))
def test_a_wrench_filled_again_is_the_wrench_made_anew(contents):
    writer = messages.WrenchWriter(BASE_FRAME)
    for stamp, values in contents:
        again = serialize_message(writer.fill(stamp, values))
        assert again == serialize_message(messages.wrench_message(stamp, BASE_FRAME, values))


@given(stamps, st.text(max_size=9))
def test_the_stamp_of_a_serialized_message_is_that_of_its_header(stamp, frame):
    message = messages.joint_state_message(stamp, JOINT_NAMES, *np.ones((3, 7)))
    message.header.frame_id = frame
    data = serialize_message(message)
    assert read_stamp(data) == stamp
    assert read_stamp(data[: 16 + len(frame.encode()) + 1]) == stamp


@pytest.mark.parametrize("length", [0, 3, 11, 15, 16])
def test_a_header_that_is_cut_off_has_no_stamp(length):
    data = serialize_message(messages.joint_state_message(5, JOINT_NAMES, *np.ones((3, 7))))
    with pytest.raises(message_arrays.BadMessage, match="Header"):
        read_stamp(data[:length])


def joint_state(**changes):
    message = messages.joint_state_message(5, JOINT_NAMES, *np.ones((3, 7)))
    for name, value in changes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    "changes, kind, text",
    [
        ({"name": list(reversed(JOINT_NAMES))}, "names", "panda_joint1"),
        ({"name": []}, "names", "got \\[\\]"),
        ({"position": [0.0] * 6}, "shape", "position: expected shape \\(7,\\), got \\(6,\\)"),
        ({"effort": []}, "shape", "effort"),
        ({"velocity": [0.0] * 6 + [float("nan")]}, "finite", "velocity.*nan"),
        ({"effort": [float("inf")] * 7}, "finite", "effort.*inf"),
    ],
)
def test_joint_state_refused(changes, kind, text):
    with pytest.raises(BadMessage, match=text) as refusal:
        message_arrays.joint_state_arrays(joint_state(**changes), JOINT_NAMES)
    assert refusal.value.kind == kind


@given(stamps, vectors(3), vectors(4, low=-1, high=1).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_pose_round_trip(stamp, position, quaternion):
    quaternion = quaternion / np.linalg.norm(quaternion)
    message = sent(messages.pose_message(stamp, "panda_link0", position, quaternion))
    assert message.pose.orientation.w == quaternion[0]
    got = message_arrays.pose_arrays(message, "panda_link0")
    np.testing.assert_array_equal(got[0], position)
    np.testing.assert_array_equal(got[1], quaternion)


def test_pose_refused():
    message = messages.pose_message(0, "world", np.zeros(3), [1, 0, 0, 0])
    with pytest.raises(BadMessage, match="expected 'panda_link0', got 'world'"):
        message_arrays.pose_arrays(message, "panda_link0")
    unset = PoseStamped()
    unset.pose.orientation.w = 0.5
    with pytest.raises(BadMessage, match="expected norm 1 .* got 0.5"):
        message_arrays.pose_arrays(unset, "")
    message.pose.position.z = float("nan")
    with pytest.raises(BadMessage, match="position.*nan"):
        message_arrays.pose_arrays(message, "world")


@given(st.data(), st.integers(0, 12), stamps)
def test_trajectory_round_trip(data, points, stamp):
    steps = data.draw(st.lists(st.integers(1, 10**10), min_size=points, max_size=points))
    times = np.cumsum(np.array(steps, dtype=np.int64)) / 1e9
    positions, velocities = data.draw(vectors(points, 7)), data.draw(vectors(points, 7))
    message = sent(messages.trajectory_message(stamp, JOINT_NAMES, times, positions, velocities))
    got = message_arrays.trajectory_arrays(message, JOINT_NAMES)
    np.testing.assert_array_equal(got[0], times)
    np.testing.assert_array_equal(got[1], positions)
    np.testing.assert_array_equal(got[2], velocities)


def test_trajectory_refused():
    positions = np.zeros((3, 7))
    backwards = messages.trajectory_message(0, JOINT_NAMES, [0.0, 0.2, 0.1], positions, positions)
    with pytest.raises(BadMessage, match="increasing, got \\[0, 200000000, 100000000\\]"):
        message_arrays.trajectory_arrays(backwards, JOINT_NAMES)
    short = messages.trajectory_message(0, JOINT_NAMES, [0.0, 0.1, 0.2], positions, positions)
    short.points[1].velocities = [0.0]
    with pytest.raises(BadMessage, match="velocities: expected shape \\(7,\\), got \\(1,\\)"):
        message_arrays.trajectory_arrays(short, JOINT_NAMES)
    with pytest.raises(BadMessage, match="names"):
        message_arrays.trajectory_arrays(short, STATE_NAMES)


@given(vectors(2, 7))
def test_gains_round_trip(gains):
    np.testing.assert_array_equal(message_arrays.gains_array(sent(messages.gains_message(gains))), gains)


def test_gains_refused():
    message = messages.gains_message(np.ones((2, 7)))
    message.data[3] = float("nan")
    with pytest.raises(BadMessage, match="nan"):
        message_arrays.gains_array(message)
    message.layout.dim.reverse()
    with pytest.raises(BadMessage, match="joint"):
        message_arrays.gains_array(message)
    with pytest.raises(BadMessage, match="shape \\(2, 7\\), got \\(7, 2\\)"):
        messages.gains_message(np.ones((7, 2)))


@given(
    stamps,
    vectors(8, 2, low=-1e5, high=1e5, width=32, dtype=np.float32),
    vectors(8, low=0, high=1, width=32, dtype=np.float32),
)
def test_keypoints_round_trip(stamp, pixels, scores):
    keypoints = np.column_stack([pixels, scores]).astype(np.float64)
    message = sent(messages.keypoints_message(stamp, "camera_optical", keypoints))
    np.testing.assert_array_equal(message_arrays.keypoints_array(message), keypoints)


@pytest.mark.parametrize(
    "changes, kind",
    [
        ({"width": 7}, "shape"),
        ({"is_bigendian": True}, "encoding"),
        ({"fields": []}, "encoding"),
        ({"data": b"\0" * 95}, "shape"),
        ({"data": np.full(24, np.nan, "<f4").tobytes()}, "finite"),
        ({"data": np.full(24, 2.0, "<f4").tobytes()}, "range"),
    ],
)
def test_keypoints_refused(changes, kind):
    message = messages.keypoints_message(0, "camera_optical", np.ones((8, 3)))
    for name, value in changes.items():
        setattr(message, name, value)
    with pytest.raises(BadMessage) as refusal:
        message_arrays.keypoints_array(message)
    assert refusal.value.kind == kind


@given(stamps, st.integers(1, 12).flatmap(lambda h: st.integers(1, 12).flatmap(lambda w: arrays(np.uint8, (h, w, 3)))))
def test_image_round_trip(stamp, pixels):
    message = sent(messages.image_message(stamp, "camera_optical", pixels))
    np.testing.assert_array_equal(message_arrays.image_array(message), pixels)


def test_image_with_padded_rows_is_read():
    pixels = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    message = messages.image_message(0, "camera_optical", pixels)
    message.step = 12
    message.data = np.pad(pixels.reshape(2, 9), ((0, 0), (0, 3))).tobytes()
    np.testing.assert_array_equal(message_arrays.image_array(message), pixels)


@pytest.mark.parametrize(
    "changes, kind",
    [
        ({"encoding": "mono16"}, "encoding"),
        ({"height": 5}, "shape"),
        ({"data": b""}, "shape"),
        ({"height": 0, "data": b""}, "shape"),
    ],
)
def test_image_refused(changes, kind):
    message = messages.image_message(0, "camera_optical", np.zeros((4, 4, 3), np.uint8))
    for name, value in changes.items():
        setattr(message, name, value)
    with pytest.raises(BadMessage) as refusal:
        message_arrays.image_array(message)
    assert refusal.value.kind == kind


def test_camera_info_round_trip():
    width, height, matrix = message_arrays.camera_info_arrays(
        sent(messages.camera_info_message(1, "camera_optical", CAMERA))
    )
    assert (width, height) == (CAMERA.width, CAMERA.height)
    np.testing.assert_array_equal(matrix, CAMERA.matrix)
    distorted = messages.camera_info_message(1, "camera_optical", CAMERA)
    distorted.d = [0.1, 0.0, 0.0, 0.0, 0.0]
    with pytest.raises(BadMessage, match="rectified"):
        message_arrays.camera_info_arrays(distorted)


@pytest.mark.parametrize(
    "changes, text",
    [
        (
            dict(distortion_model="equidistant"),
            "got 'equidistant' with 5",
        ),  # no pinhole, also where its coefficients are zero
        (dict(distortion_model="", d=[0.1, 0.0, 0.0, 0.0, 0.0]), "expected plumb_bob"),
        (dict(distortion_model="rational_polynomial", d=[0.0] * 7 + [0.1]), "expected plumb_bob"),
        (dict(k=[0.0] * 9), "expected a calibrated camera"),
        (dict(binning_x=2), "expected whole images, got binning 2 x 0"),
        (dict(roi=RegionOfInterest(x_offset=8, width=100, height=100)), "expected whole images"),
    ],
)
def test_a_camera_that_is_no_whole_pinhole_is_refused(changes, text):
    message = messages.camera_info_message(1, "camera", CAMERA)
    for name, value in changes.items():
        setattr(message, name, value)
    with pytest.raises(BadMessage, match=text):
        message_arrays.camera_info_lens(message)


def test_r_turns_the_images_of_our_camera_node_alone():
    """Of any other camera it is a stereo rectification, which is not applied to image_raw."""
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for frame, expected in (("camera", np.eye(3)), (message_arrays.TURNED_CAMERA, turn)):
        message = messages.camera_info_message(1, frame, CAMERA, turn)
        np.testing.assert_array_equal(message_arrays.camera_info_lens(message)[1], expected)
    known = messages.camera_info_message(1, "camera", CAMERA, turn)
    np.testing.assert_array_equal(message_arrays.camera_info_lens(known, is_turned=True)[1], turn)
    known.distortion_model, known.d = "rational_polynomial", [0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0]
    assert message_arrays.camera_info_lens(known)[0].distortion == (0.1, 0.2, 0.3, 0.4, 0.5)
