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
from np_record.bag import BagError, TopicMessages
from np_record.bulk import read_joint_states, serialize_joint_states
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
    return read_joint_states("bag b", rows(*messages), names)


@pytest.mark.parametrize("frame", ["", "w", "panda_link0"])
@pytest.mark.parametrize("order", [np.arange(9), np.arange(9)[::-1], np.array([4, 2, 7])])
def test_numbers_are_those_of_the_names_in_whatever_order(frame, order):
    stamps, values = read(*(message(step, frame=frame) for step in range(5)), names=[STATE_NAMES[i] for i in order])
    np.testing.assert_array_equal(stamps, 7 * np.arange(5))
    np.testing.assert_array_equal(values, (np.arange(27.0).reshape(3, 9) + np.arange(5.0)[:, None, None])[:, :, order])


def test_what_is_not_asked_for_refuses_nothing():
    """A gripper that publishes in turn, one that says no effort, frames that differ, padding that DDS left, a message that comes twice."""
    hand = np.arange(27.0).reshape(3, 9)
    hand[:, 7:] = np.nan
    gripper = message(2, names=("fingers",), numbers=(hand[0, :1], [], []))
    padded = bytearray(message(3, frame="ab"))
    padded[19:20] = b"\x07"  # between the frame and the number of names
    odd = [message(step, frame=f"frame {step}" * step) for step in range(4, 40)]
    stamps, values = read(
        message(0, numbers=hand), message(1), message(1), gripper, bytes(padded), *odd, names=STATE_NAMES[:7]
    )
    assert stamps.tolist() == [7 * i for i in (0, 1, 2, *range(4, 41))]
    np.testing.assert_array_equal(values[4], np.arange(27.0).reshape(3, 9)[:, :7] + 4)
    _, again = read_joint_states(
        "bag b", TopicMessages(TIMELINE, np.zeros(2, int), [message(1), message(1)]), STATE_NAMES
    )
    assert len(again) == 1


def test_none_are_no_rows():
    for nothing in (None, rows()):
        stamps, values = read_joint_states("bag b", nothing, STATE_NAMES)
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
        (
            dict(names=STATE_NAMES[:-1]),
            "at 14 ns: expected each joint once in a message, panda_finger_joint2 is not in",
        ),
        (
            dict(names=("panda_joint1", *STATE_NAMES[:-1])),
            "at 14 ns: expected each joint once in a message, panda_joint1, ",
        ),
        (
            dict(numbers=LAST),
            "at 14 ns: JointState.velocity of panda_joint5: expected finite numbers, got nan, and 1 such",
        ),
        (dict(numbers=LAST[:, :3]), r"at 14 ns: JointState.position: expected shape \(9,\), got \(3,\)"),
        (dict(numbers=(LAST[0], LAST[0], [])), r"at 14 ns: JointState.effort: expected shape \(9,\), got \(0,\)"),
        (
            dict(numbers=(LAST[0], LAST[0, :8], np.arange(10.0))),
            r"at 14 ns: JointState.velocity: expected shape \(9,\), got \(8,\)",
        ),
    ],
)
def test_a_message_that_cannot_be_used_is_named(third, text):
    with pytest.raises(BagError, match="bag b: joint_states " + text):
        read(message(0), message(1), message(2, **third), message(3))


def test_joints_of_nobody_and_broken_bytes_are_named():
    with pytest.raises(BagError, match="bag b: joint_states: expected joints elbow, got panda_joint1, panda_joint2"):
        read(message(0), names=("elbow",))
    with pytest.raises(BagError, match="bag b: joint_states at 7 ns: expected a readable message"):
        read(message(0), message(1)[:-9])
