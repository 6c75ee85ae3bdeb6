"""The messages of a topic at once are those that come one by one."""

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from np_record.bag import Recording
from np_record.cdr import TYPESTORE

TEXT, NUMBER = "std_msgs/msg/String", "std_msgs/msg/Float64"
TOPICS = ("/phase", "/gripper_command")


def record(path, plugin=StoragePlugin.MCAP):
    """Two topics and a third, 60 kB, times that go back now and then."""
    rng = np.random.default_rng(0)
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        kinds = dict(zip((*TOPICS, "/another"), (TEXT, NUMBER, TEXT)))
        connections = {t: writer.add_connection(t, kind, typestore=TYPESTORE) for t, kind in kinds.items()}
        for n in range(900):
            topic = [*kinds][rng.integers(3)]
            writer.write(connections[topic], 1000 + 10 * n - int(rng.integers(40)), rng.bytes(int(rng.integers(4, 90))))
    return path


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_rows_are_the_messages_of_each_topic(tmp_path, plugin):
    with Recording(record(tmp_path / "bag", plugin), required=["phase"]) as recording:
        rows = recording.rows("phase", "gripper_command", "goal_pose")
        assert set(rows) == {"phase", "gripper_command"}
        for name, own in rows.items():
            assert list(own) == list(recording.messages(name)) and len(own) == recording.counts[name]
