"""Zeroed padding against rclpy's own serializer, with garbage put wherever no field lies."""

import pytest
from geometry_msgs.msg import PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from np_record.cdr import header_stamp, padding_filter

names = st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=12)
numbers = st.lists(st.floats(allow_nan=False), max_size=5)


@st.composite
def joint_states(draw):
    message = JointState(
        name=draw(st.lists(names, max_size=4)),
        position=draw(numbers),
        velocity=draw(numbers),
        effort=draw(numbers),
    )
    message.header.frame_id = draw(names)
    message.header.stamp.sec = draw(st.integers(0, 2**31 - 1))
    message.header.stamp.nanosec = draw(st.integers(0, 10**9 - 1))
    return message


@st.composite
def trajectories(draw):
    points = [
        JointTrajectoryPoint(positions=draw(numbers), velocities=draw(numbers), effort=draw(numbers))
        for _ in range(draw(st.integers(0, 3)))
    ]
    message = JointTrajectory(joint_names=draw(st.lists(names, max_size=3)), points=points)
    message.header.frame_id = draw(names)
    return message


def type_name(message):
    return f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"


def with_garbage(data: bytes, kind, value: int) -> bytes:
    """`data` with `value` in every byte that does not change what the message says."""
    original = deserialize_message(data, kind)
    changed = bytearray(data)
    for i in range(4, len(data)):
        trial = bytearray(changed)
        trial[i] = value
        try:
            same = deserialize_message(bytes(trial), kind) == original
        except Exception:  # lengths that no longer fit
            same = False
        if same:
            changed = trial
    return bytes(changed)


@settings(max_examples=60)
@given(st.one_of(joint_states(), trajectories()))
def test_padding_does_not_survive_and_fields_do(message):
    clean = padding_filter(type_name(message))
    data = serialize_message(message)
    result = clean(data)
    assert deserialize_message(result, type(message)) == message
    assert clean(result) == result and len(result) == len(data)


@pytest.mark.parametrize(
    "message",
    [
        JointState(header=Header(frame_id="ab"), name=["a", "bcd"], position=[1.5], velocity=[2.5], effort=[3.5]),
        PoseStamped(header=Header(frame_id="base")),
        CameraInfo(distortion_model="plumb_bob", d=[0.5]),
        JointTrajectory(
            joint_names=["j"], points=[JointTrajectoryPoint(positions=[1.5], velocities=[0.5], effort=[2.5])]
        ),
    ],
)
def test_equal_messages_become_equal_bytes(message):
    clean = padding_filter(type_name(message))
    data = serialize_message(message)
    one, other = (with_garbage(data, type(message), value) for value in (0x33, 0xCC))
    assert one != other, "the message has no padding: a weak test"
    assert clean(one) == clean(other)


@given(joint_states())
def test_stamp_is_read_from_the_bytes(message):
    stamp = message.header.stamp
    assert header_stamp(serialize_message(message)) == stamp.sec * 10**9 + stamp.nanosec


def test_truncated_messages_are_refused():
    data = serialize_message(JointState(name=["a"], position=[1.0], velocity=[1.0], effort=[1.0]))
    for length in (5, 20, len(data) - 8):
        with pytest.raises(ValueError, match="expected at least"):
            padding_filter("sensor_msgs/msg/JointState")(data[:length])
    with pytest.raises(ValueError, match="expected little-endian CDR"):
        header_stamp(data[:8])
