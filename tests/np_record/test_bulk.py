"""Joint states read from their bytes: what one by one would be read, the same refusals; and written to them."""

from array import array

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from np_description.panda import STATE_NAMES
from np_record.bag import TopicMessages
from np_record.bulk import BulkError, joint_states, serialize_joint_states
from np_record.topics import TIMELINE


def message(step, names=STATE_NAMES, frame="", numbers=None):
    values = np.arange(27.0).reshape(3, 9)[:, : len(names)] + step if numbers is None else numbers
    stamp = Time(sec=3 * step // 2, nanosec=step % 2 * 500_000_000)
    header = Header(stamp=stamp, frame_id=frame)
    position, velocity, effort = (array("d", part) for part in values)
    return serialize_message(
        JointState(header=header, name=list(names), position=position, velocity=velocity, effort=effort)
    )


def rows(*messages):
    return TopicMessages(TIMELINE, np.arange(len(messages)) * 7, list(messages))


def read(*messages, names=STATE_NAMES):
    return joint_states("bag b", "joint_states", rows(*messages), names)


@pytest.mark.parametrize("frame", ["", "w", "panda_link0"])
@pytest.mark.parametrize("names", [STATE_NAMES, None])
def test_numbers_and_stamps_are_those_of_the_messages(frame, names):
    stamps, values = read(*(message(step, frame=frame) for step in range(5)), names=names)
    np.testing.assert_array_equal(stamps, 1_500_000_000 * np.arange(5))
    np.testing.assert_array_equal(values, np.arange(27.0).reshape(3, 9) + np.arange(5.0)[:, None, None])


def test_none_are_no_rows():
    for nothing in (None, rows()):
        stamps, values = joint_states("bag b", "joint_states", nothing, STATE_NAMES)
        assert stamps.shape == (0,) and values.shape == (0, 3, 9)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.text("panda_j1", max_size=12), min_size=1, max_size=9), st.integers(0, 5))
def test_what_is_written_at_once_is_what_ros_reads(names, count):
    stamps = 1_999_999_993 * np.arange(count, dtype=np.int64)
    parts = np.random.default_rng(count).normal(size=(3, count, len(names)))
    written = [deserialize_message(data, JointState) for data in serialize_joint_states(stamps, names, *parts)]
    assert len(written) == count
    for row, state in enumerate(written):
        assert state.header.stamp.sec * 10**9 + state.header.stamp.nanosec == stamps[row]
        assert state.header.frame_id == "" and state.name == names
        for values, expected in zip((state.position, state.velocity, state.effort), parts[:, row]):
            np.testing.assert_array_equal(values, expected)


LAST = np.arange(27.0).reshape(3, 9)
LAST[1, 4] = np.nan


@pytest.mark.parametrize(
    "third, text",
    [
        (dict(names=STATE_NAMES[:-1]), "at 14 ns: JointState.name: expected the names"),
        (dict(names=(*STATE_NAMES[1::-1], *STATE_NAMES[2:])), "at 14 ns: JointState.name: expected the names"),
        (dict(frame="w"), "at 14 ns: expected the frame of the first message"),
        (dict(frame="other"), "at 14 ns: expected the frame of the first message"),
        (dict(numbers=LAST), r"at 14 ns: JointState.velocity: expected finite numbers, got \[9.0, .*nan"),
        (dict(numbers=LAST[:, :3]), r"at 14 ns: JointState.position: expected shape \(9,\), got \(3,\)"),
        (dict(numbers=(LAST[0], LAST[0], [])), r"at 14 ns: .*expected (a readable message|shape)"),
        (
            dict(numbers=(LAST[0], LAST[0, :8], np.arange(10.0))),
            r"at 14 ns: JointState.velocity: expected shape \(9,\), got \(8,\)",
        ),
    ],
)
def test_a_message_unlike_the_first_is_named(third, text):
    with pytest.raises(BulkError, match="bag b: joint_states " + text):
        read(message(0), message(1), message(2, **third), message(3))
