"""Order, completeness and errors of recordings, on the library half of the recorder."""

import os
import random
import re
import subprocess
import sys
from io import FileIO
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from std_msgs.msg import String

from np_description.panda import STATE_NAMES
from np_description.phases import PhaseState
from np_record.bag import BagError, Recording
from np_record.bag_writer import INCOMPLETE, BagWriter
from np_record.cdr import TYPESTORE
from np_record.recorder import HORIZON, Sequencer
from np_record.topics import BY_NAME, TIMELINE, TOPICS
from np_ros.messages import gains_message, joint_state_message, pose_message
from np_ros.phases import phase_message

PERIOD = 2_000_000
CONTRACT = Path(__file__).resolve().parents[2] / "docs/reference/graph.md"


def state(step: int) -> bytes:
    return serialize_message(joint_state_message(step * PERIOD, STATE_NAMES, *np.full((3, 9), float(step))))


def pose(step: int) -> bytes:
    return serialize_message(
        pose_message(step * PERIOD, "panda_link0", np.full(3, float(step)), np.array([1.0, 0, 0, 0]))
    )


def run(length: int):
    """(topic, data, time of publishing, number): a phase is announced between states 20 and 21."""
    messages = [(TIMELINE, state(i), 1000 * i, i) for i in range(length)]
    messages += [(BY_NAME["object_pose"], pose(i), 1000 * i + 10, i // 5) for i in range(0, length, 5)]
    messages += [(BY_NAME["episode/phase"], serialize_message(phase_message(PhaseState("post"))), 20_500, 1)]
    return sorted(messages, key=lambda m: m[2])


def sequence(messages):
    out = []
    sequencer = Sequencer(lambda *item: out.append(item))
    for message in messages:
        sequencer.add(*message)
    sequencer.flush()
    return out, sequencer


def record(path, length=200, information=None):
    writer = BagWriter(path, information or {"seed": 3})
    sequencer = Sequencer(writer.write)
    for message in run(length):
        sequencer.add(*message)
    sequencer.flush()
    writer.close()
    return path


def test_what_a_restarted_backend_says_before_the_beginning_of_the_bag_is_counted():
    """The states from before the reset are left out by design; those of the backend that begins anew are missing."""
    out = []
    sequencer = Sequencer(lambda *item: out.append(item), BY_NAME["goal_pose"])
    for number, step in enumerate([*range(90, 110), *range(5)]):
        sequencer.add(TIMELINE, state(step), 1000 * number, number)
        if step == 95:
            sequencer.add(BY_NAME["goal_pose"], pose(100), 1000 * number + 1, 0)
            assert not sequencer.lost
    sequencer.flush()
    assert [stamp for stamp, topic, _ in out if topic is TIMELINE] == [step * PERIOD for step in range(100, 110)]
    assert sequencer.lost >= 5


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32))
def test_order_of_arrival_does_not_matter(seed):
    """Topics overtake each other, by less than the horizon; each topic by itself stays in order."""
    expected, _ = sequence(run(100))
    rng, queues, mixed = random.Random(seed), {}, []
    for message in run(100):
        queues.setdefault(message[0].name, []).append(message)
    while queues:
        name = rng.choice(sorted(queues))
        mixed.append(queues[name].pop(0))
        if not queues[name]:
            del queues[name]
    assert 100 * PERIOD < HORIZON
    result, _ = sequence(mixed)
    assert result == expected
    assert [s for s, _, _ in result] == sorted(s for s, _, _ in result)


def test_a_message_without_a_stamp_gets_that_of_the_state_before_it():
    result, _ = sequence(run(50))
    assert [s for s, topic, _ in result if topic.name == "episode/phase"] == [20 * PERIOD]


@given(st.integers(1, 10**5), st.integers(1, 48), st.booleans())
def test_a_clock_set_back_moves_no_message_without_a_stamp(back, at, is_overtaken):
    """Wherever the clock is set back, before or after the phase: it is stamped as without that, or a few states away.

    A jump of a few states cannot be told from their scatter: the message may have been sent before or after it, four states at most, or
    nine where three states overtake it. A longer jump is told.
    """
    messages = [(t, data, wall - (back if wall >= 1000 * at else 0), n) for t, data, wall, n in run(50)]
    if is_overtaken:
        place = next(i for i, message in enumerate(messages) if message[0].name == "episode/phase")
        messages.insert(place + 3, messages.pop(place))
    result, sequencer = sequence(messages)
    [stamp] = [s for s, topic, _ in result if topic.name == "episode/phase"]
    assert abs(stamp - 20 * PERIOD) <= (9 if is_overtaken else 4) * PERIOD and not sequencer.lost


def test_what_is_sent_again_is_kept_once_and_what_is_missing_is_counted():
    messages = run(50)
    result, sequencer = sequence([m for message in messages for m in (message, message)])
    assert result == sequence(messages)[0] and sequencer.repeated == len(messages)
    _, sequencer = sequence([m for m in messages if not (m[0] is TIMELINE and m[3] in (7, 8, 30))])
    assert sequencer.lost == 3


def test_equal_messages_at_different_times_are_both_kept():
    gains = serialize_message(gains_message(np.ones((2, 7))))
    messages = [
        (TIMELINE, state(0), 0, 0),
        (BY_NAME["target_gains"], gains, 1, 0),
        (TIMELINE, state(1), 2, 1),
        (BY_NAME["target_gains"], gains, 3, 1),
        (TIMELINE, state(2), 4, 2),
    ]
    result, _ = sequence(messages)
    assert [s for s, topic, _ in result if topic.name == "target_gains"] == [0, PERIOD]


def test_an_episode_begins_with_its_goal():
    goal = BY_NAME["goal_pose"]
    messages = sorted([*run(60), (goal, pose(30), 29_900, 0)], key=lambda m: m[2])
    out = []
    sequencer = Sequencer(lambda *item: out.append(item), begin_at=goal)
    for message in messages:
        sequencer.add(*message)
    sequencer.flush()
    assert out == [item for item in sequence(messages)[0] if item[0] >= 30 * PERIOD]


def test_a_bag_holds_what_was_recorded(tmp_path):
    with Recording(record(tmp_path / "bag"), required=["joint_states", "episode/phase"]) as recording:
        assert recording.information == {"seed": 3}
        assert recording.counts["joint_states"] == 200 and recording.counts["episode/tick"] == 0
        assert [(m.stamp, m.topic, m.data) for m in recording.messages()] == sequence(run(200))[0]
        first = next(recording.messages("object_pose")).decode()
        assert first.header.frame_id == "panda_link0" and first.pose.orientation.w == 1.0
        assert (recording.start, recording.end) == (0, 199 * PERIOD)


def test_equal_runs_make_equal_files(tmp_path):
    one, other = record(tmp_path / "1" / "bag"), record(tmp_path / "2" / "bag")
    for name in ("bag.mcap", "metadata.yaml"):
        assert (one / name).read_bytes() == (other / name).read_bytes()
    different = record(tmp_path / "3" / "bag", length=199)
    assert Recording(one).digest() == Recording(other).digest() != Recording(different).digest()


def test_an_existing_bag_is_not_overwritten(tmp_path):
    record(tmp_path / "bag")
    with pytest.raises(FileExistsError, match="expected a new path"):
        BagWriter(tmp_path / "bag", {})


@pytest.mark.parametrize("part", [0.0, 0.3, 0.9, 0.999])
def test_a_truncated_bag_is_named(tmp_path, part):
    file = record(tmp_path / "bag") / "bag.mcap"
    file.write_bytes(file.read_bytes()[: int(part * file.stat().st_size)])
    with pytest.raises(BagError, match="expected a complete rosbag2 recording"):
        Recording(tmp_path / "bag")


def test_a_bag_without_its_metadata_is_named(tmp_path):
    (record(tmp_path / "bag") / "metadata.yaml").unlink()
    with pytest.raises(BagError, match="expected metadata.yaml.*cut off"):
        Recording(tmp_path / "bag")


def test_a_damaged_message_is_named(tmp_path):
    file = record(tmp_path / "bag", length=4000) / "bag.mcap"
    data = bytearray(file.read_bytes())
    middle = len(data) // 3
    data[middle : middle + 4096] = b"\xff" * 4096
    file.write_bytes(data)
    with (
        pytest.raises(BagError, match="expected readable messages"),
        Recording(tmp_path / "bag") as recording,
    ):
        for message in recording.messages():
            message.decode()


def foreign(path, topic, message_type, data):
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.write(writer.add_connection(topic, message_type, typestore=TYPESTORE), 1, data)
    return path


def test_a_foreign_bag_is_named(tmp_path):
    chatter = foreign(tmp_path / "a", "/chatter", "std_msgs/msg/String", serialize_message(String(data="hello")))
    with pytest.raises(BagError, match=r"expected messages on .*graph.md; it has /chatter \(std_msgs/msg/String, 1\)"):
        Recording(chatter)
    wrong = foreign(tmp_path / "b", "/joint_states", "geometry_msgs/msg/PoseStamped", serialize_message(PoseStamped()))
    with pytest.raises(
        BagError, match="joint_states .geometry_msgs/msg/PoseStamped, expected sensor_msgs/msg/JointState, 1"
    ):
        Recording(wrong)
    with pytest.raises(BagError, match="expected messages on episode/tick, effort_command; it has"):
        Recording(record(tmp_path / "c"), required=["joint_states", "episode/tick", "effort_command"])
    former = foreign(tmp_path / "d", "/phase", "std_msgs/msg/String", serialize_message(String(data="idle")))
    with pytest.raises(BagError, match=r"on episode/phase; it has /phase .*With phase, it was recorded by an earlier"):
        Recording(former, required=["episode/phase"])
    with pytest.raises(BagError, match="does not exist"):
        Recording(tmp_path / "nothing")


@pytest.mark.parametrize("text", ["evening, arm 2", "5", "[1]", ""])
def test_run_info_of_another_form_is_named_where_it_is_asked_for(tmp_path, text):
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.set_custom_data("run_info", text)
        writer.write(writer.add_connection("/joint_states", TIMELINE.type, typestore=TYPESTORE), 7, state(0))
    with Recording(tmp_path / "bag") as recording:
        assert recording.counts == {"joint_states": 1} and recording.information_or_none == {}
        with pytest.raises(BagError, match="expected a JSON object as run_info"):
            len(recording.information)


def test_messages_without_a_stamp_of_their_own_are_dated_by_the_log(tmp_path):
    """As a driver writes them that leaves the header empty: by log times of the same clock, else not at all."""
    topics = {"joint_states": TIMELINE, "object_pose": BY_NAME["object_pose"]}
    for name, late in (("same", 0), ("other", 10**18)):
        with Writer(tmp_path / name, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {n: writer.add_connection(f"/{n}", t.type, typestore=TYPESTORE) for n, t in topics.items()}
            for step in range(1, 4):
                writer.write(connections["joint_states"], step * PERIOD + late, state(step))
                writer.write(connections["object_pose"], step * PERIOD + late, pose(0))
    stamps = [step * PERIOD for step in range(1, 4)]
    with Recording(tmp_path / "same") as recording:
        assert [m.stamp for m in recording.messages("object_pose")] == stamps
    with Recording(tmp_path / "other") as recording:
        assert [m.stamp for m in recording.messages("joint_states")] == stamps
        with pytest.raises(BagError, match="object_pose: expected messages with a stamp"):
            next(recording.messages("object_pose"))


FULL = """
import resource, sys
from test_recorder import TIMELINE, BagWriter, state
writer = BagWriter(sys.argv[1], {"seed": 3})
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))  # the kernel refuses what is beyond
written = 0
try:
    while True:
        writer.write(written, TIMELINE, state(written))
        written += 1
except OSError:
    pass
try:
    writer.close()
except OSError as error:
    sys.exit(str(error))
"""


FULL_AT_FIRST = """
import resource, sys
from test_recorder import BagWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, resource.RLIM_INFINITY))
try:
    BagWriter(sys.argv[1], {"seed": 3})
except OSError as error:
    sys.exit(str(error))
"""


def test_a_bag_on_a_disk_that_becomes_full_is_closed_readable_and_named_incomplete(tmp_path):
    """As many whole chunks as there is room for, and every message of them."""
    path = tmp_path / "bag"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [sys.executable, "-c", FULL, path, str(5 << 20)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    told = re.fullmatch(
        rf"bag {path}: cannot be written: File too large; it ends early, readable, with (\d+) messages\n", done.stderr
    )
    assert told, done.stderr
    count = int(told.group(1))
    with Recording(path) as recording:
        assert recording.counts["joint_states"] == count > 5000
        stamps = [message.stamp for message in recording.messages()]
        assert stamps == [PERIOD * step for step in range(count)] and recording.end == stamps[-1]
        assert recording.information == {"seed": 3, INCOMPLETE: f"File too large, after {count} messages"}
    assert sorted(file.name for file in path.iterdir()) == ["bag.mcap", "metadata.yaml"]


def test_a_bag_for_which_there_is_no_room_leaves_nothing(tmp_path):
    """A folder without metadata.yaml would be taken for a recording that broke off."""
    path = tmp_path / "bag"
    command = [sys.executable, "-c", FULL_AT_FIRST, path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.stderr == f"bag {path}: cannot be made: File too large\n"
    assert not list(tmp_path.iterdir())


def test_a_disk_without_room_for_an_index_either_is_told(tmp_path):
    writer = BagWriter(tmp_path / "bag", {})
    writer._storage.bio.close()
    writer._storage.bio = FullDevice("/dev/full", "w")
    with pytest.raises(OSError, match="cannot be written: No space left.*incomplete: without index or metadata"):
        for i in range(1 << 20):
            writer.write(i, TIMELINE, state(i))
    with pytest.raises(OSError, match="No space left on device; it is incomplete"):
        writer.close()
    with pytest.raises(BagError, match="expected metadata.yaml.*cut off"):
        Recording(tmp_path / "bag")


class FullDevice(FileIO):
    """/dev/full, which cannot be cut short: as a disk that cannot be written at all."""

    def seek(self, *_):
        return 0

    def truncate(self, *_):
        return 0


def test_the_contract_lists_every_topic_that_is_recorded_with_its_type():
    section = CONTRACT.read_text(encoding="utf-8").partition("## Topics")[2].partition("\n#")[0]
    rows = [row.split("|") for row in re.findall(r"^\| `.*\|$", section, re.MULTILINE)]
    told = {name: (row[2], "(latched)" in row[1]) for row in rows for name in re.findall(r"`([\w/]+)`", row[1])}
    assert told.keys() == {topic.name for topic in TOPICS}
    for topic in TOPICS:
        kind, is_latched = told[topic.name]
        assert topic.type.rpartition("/")[2] in kind and topic.type.partition("/")[0] in kind, topic.name
        assert is_latched == topic.latched, topic.name
