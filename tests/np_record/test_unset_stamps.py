"""A gripper's driver that leaves its stamps empty takes no time from the arm that shares its topic."""

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer

from np_description.panda import JOINT_NAMES
from np_record.bag import Recording
from np_record.cdr import TYPESTORE
from np_record.topics import BY_NAME
from np_ros.messages import gains_message, joint_state_message

PERIOD, COUNT = 2_000_000, 500


@pytest.mark.parametrize("begin", [5_000_000_000, 1_760_000_000_000_000_000])
def test_messages_without_a_stamp_date_nothing(tmp_path, begin):
    arm = [begin + PERIOD * n for n in range(COUNT)]
    zeros = np.zeros(7)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {name: BY_NAME[name] for name in ("joint_states", "target_gains")}
        to = {name: writer.add_connection(f"/{name}", t.type, typestore=TYPESTORE) for name, t in topics.items()}
        gains = serialize_message(gains_message(np.ones((2, 7))))
        writer.write(to["target_gains"], begin + PERIOD, gains)
        for n, stamp in enumerate(arm):
            state = joint_state_message(stamp, JOINT_NAMES, zeros, zeros, zeros)
            writer.write(to["joint_states"], stamp, serialize_message(state))
            if n % 3 == 0:
                fingers = joint_state_message(0, ["finger"], np.zeros(1), np.zeros(1), np.zeros(1))
                writer.write(to["joint_states"], stamp + PERIOD // 2, serialize_message(fingers))
    with Recording(tmp_path / "bag") as recording:
        assert (recording.start, recording.end) == (arm[0], arm[-1])
        assert [message.stamp for message in recording.messages("target_gains")] == [begin + PERIOD]
