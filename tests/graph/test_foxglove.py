"""What the Foxglove app gets: every topic with its definition, the scene, corners in the image."""

import json
import socket
from base64 import b64encode
from types import SimpleNamespace

import pytest
from bags import record_episode
from rosbags.rosbag2.storage_mcap import McapReader

from np_description.domains import CARD
from np_record.bag import Recording
from np_record.cdr import TYPESTORE

foxglove = pytest.importorskip("foxglove", reason="make foxglove")

from np_bringup.view.foxglove_stream import CORNERS, SCENE, FoxgloveStream, play  # noqa: E402


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return record_episode(tmp_path_factory.mktemp("bag") / "episode", count=150)


def test_a_bag_comes_whole_with_the_scene(bag, tmp_path):
    context, file = foxglove.Context(), tmp_path / "out.mcap"
    ros2 = {
        "writer_options": foxglove.mcap.MCAPWriteOptions(profile="ros2"),
        "channel_filter": lambda channel: channel.topic != CORNERS,  # whose schema is no text
    }
    with foxglove.open_mcap(str(file), context=context, **ros2), Recording(bag) as recording:
        play(recording, FoxgloveStream(CARD, context), paced=False)
        sent = {f"/{message.topic.name}" for message in recording.messages()}
    reader = McapReader(file)
    reader.open()
    topics = {number: channel.topic for number, channel in reader.channels.items()}
    assert set(topics.values()) == sent | {SCENE}
    assert all(schema.data for schema in reader.schemas.values())
    markers = SimpleNamespace(id=next(number for number, topic in topics.items() if topic == SCENE))
    scenes = [data for _, _, data in reader.messages_scan([markers])]
    drawn = TYPESTORE.deserialize_cdr(scenes[-1], "visualization_msgs/msg/MarkerArray").markers
    assert len(scenes) > 3 and len(drawn) > 20
    reader.close()


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
