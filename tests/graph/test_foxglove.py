"""What the Foxglove app gets: every topic with its definition, the scene, corners in the image."""

import json
import socket
from base64 import b64encode
from types import SimpleNamespace

import numpy as np
import pytest
from bags import record_episode
from rosbags.rosbag2.storage_mcap import McapReader
from sensor_msgs.msg import JointState

from np_description.domains import CARD
from np_description.panda import NOMINAL, STATE_NAMES
from np_record.bag import Recording
from np_record.cdr import TYPESTORE
from np_ros.messages import joint_state_message, serialize

foxglove = pytest.importorskip("foxglove", reason="make foxglove")

from np_bringup.view.foxglove_stream import CORNERS, SCENE, FoxgloveStream, listen, play  # noqa: E402


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return record_episode(tmp_path_factory.mktemp("bag") / "episode", count=150)


def open_file(path, context):
    """An MCAP file that rosbags reads: without corners, whose schema is no text."""
    options = foxglove.mcap.MCAPWriteOptions(profile="ros2")
    keep = {"writer_options": options, "channel_filter": lambda channel: channel.topic != CORNERS}
    return foxglove.open_mcap(str(path), context=context, **keep)


def read_file(path) -> dict[str, list[bytes]]:
    """Messages by topic, each of which has a definition."""
    reader = McapReader(path)
    reader.open()
    assert all(schema.data for schema in reader.schemas.values())
    topics = {number: channel.topic for number, channel in reader.channels.items()}
    found = {topic: [] for topic in topics.values()}
    for channel, _, data in reader.messages_scan([SimpleNamespace(id=number) for number in topics]):
        found[topics[channel.id]].append(data)
    reader.close()
    return found


def test_a_bag_comes_whole_with_the_scene(bag, tmp_path):
    context, file = foxglove.Context(), tmp_path / "out.mcap"
    with open_file(file, context), Recording(bag) as recording:
        play(recording, FoxgloveStream(CARD, context), paced=False)
        sent = {f"/{message.topic.name}" for message in recording.messages()}
    found = read_file(file)
    assert found.keys() == sent | {SCENE}
    drawn = TYPESTORE.deserialize_cdr(found[SCENE][-1], "visualization_msgs/msg/MarkerArray").markers
    assert len(found[SCENE]) > 3 and len(drawn) > 20


def test_a_graph_comes_live(probe, tmp_path):
    context, file, heard = foxglove.Context(), tmp_path / "out.mcap", []
    state = joint_state_message(1_000_000, STATE_NAMES, np.append(NOMINAL.ready, [0.0, 0.0]), *np.zeros((2, 9)))
    probe.collect("joint_states", JointState, callback=heard.append)
    with open_file(file, context):
        listen(probe, FoxgloveStream(CARD, context))
        probe.advertise("joint_states", JointState)
        probe.wait_until(lambda: probe.matched("joint_states", 2))

        def shown():
            probe.publish("joint_states", state)
            return len(heard) > 50

        probe.wait_until(shown, what="joint states")
    found = read_file(file)
    assert found["/joint_states"][0] == serialize(state) and found[SCENE]


def test_the_server_offers_the_channels_to_whoever_connects(bag):
    context = foxglove.Context()
    server = foxglove.start_server(host="127.0.0.1", port=0, context=context)
    with Recording(bag) as recording:
        play(recording, FoxgloveStream(CARD, context), paced=False)
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as client:
        lines = ("GET / HTTP/1.1", "Host: localhost", "Upgrade: websocket", "Connection: Upgrade")
        key = f"Sec-WebSocket-Key: {b64encode(bytes(16)).decode()}"
        lines += (key, "Sec-WebSocket-Version: 13", "Sec-WebSocket-Protocol: foxglove.sdk.v1", "", "")
        client.sendall("\r\n".join(lines).encode())
        heard = b""
        while not all(topic.encode() in heard for topic in (SCENE, CORNERS)):
            part = client.recv(65536)
            assert part, heard[:500]
            heard += part
    assert json.dumps("sensor_msgs/msg/Image").encode() in heard
    server.stop()
