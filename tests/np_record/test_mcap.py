"""Messages found by the index of their chunk are those that a walk over all records finds, whatever the index says."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin, Writer

from np_record import mcap
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


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    (file,) = record(tmp_path_factory.mktemp("mcap") / "bag").glob("*.mcap")
    return file.read_bytes()


def without_index(data):
    """The same bytes with every record of an index called something unknown."""
    data, at = bytearray(data), len(mcap.MAGIC)
    while at < len(data) - len(mcap.MAGIC):
        kind, size = struct.unpack_from("<BQ", data, at)
        if kind == mcap.INDEX:
            data[at] = 0x70
        at += 9 + size
    return bytes(data)


def found(data, path):
    path.write_bytes(data)
    try:
        return list(mcap.find(path, TOPICS).messages())
    except (ValueError, struct.error, IndexError, OverflowError) as error:
        return type(error)


def test_with_or_without_an_index(whole, tmp_path):
    messages = found(whole, tmp_path / "a")
    assert len(messages) > 500 and {topic for _, topic, _ in messages} == set(TOPICS)
    assert [stamp for stamp, _, _ in messages] == sorted(stamp for stamp, _, _ in messages)
    assert found(without_index(whole), tmp_path / "b") == messages


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_a_damaged_index_is_not_believed(whole, tmp_path_factory, data):
    """Bytes behind the chunk are changed: the messages are the same, or the records cannot be followed."""
    path = tmp_path_factory.getbasetemp() / "damaged"
    first = len(mcap.MAGIC) + 9 + struct.unpack_from("<Q", whole, len(mcap.MAGIC) + 1)[0]  # after the header
    after = first + 9 + struct.unpack_from("<Q", whole, first + 1)[0]
    assert whole[first] == mcap.CHUNK and whole[after] == mcap.INDEX
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(after + 9, after + 4000))] = data.draw(st.integers(0, 255))
    answer = found(bytes(damaged), path)
    assert answer == found(without_index(whole), path) or isinstance(answer, type)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_damaged_messages_are_what_a_walk_over_the_records_makes_of_them(whole, tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "damaged"
    plain, damaged = bytearray(without_index(whole)), bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        at, value = data.draw(st.integers(100, 50000)), data.draw(st.integers(0, 255))
        plain[at] = damaged[at] = value
    assert found(bytes(damaged), path) == found(bytes(plain), path)


def test_a_length_that_makes_a_footer_of_a_schemas_text_ends_nothing(whole, tmp_path):
    """Walked, such a chunk seemed to end before its messages; by its index it had them all."""
    damaged = bytearray(whole)
    damaged[218] = 0  # in the length of the second channel's schema
    assert found(bytes(damaged), tmp_path / "a") is ValueError
    assert found(without_index(bytes(damaged)), tmp_path / "b") is ValueError


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_rows_are_the_messages_of_each_topic(tmp_path, plugin):
    with Recording(record(tmp_path / "bag", plugin), required=["phase"]) as recording:
        rows = recording.rows("phase", "gripper_command", "goal_pose")
        assert set(rows) == {"phase", "gripper_command"}
        for name, own in rows.items():
            assert list(own) == list(recording.messages(name)) and len(own) == recording.counts[name]
