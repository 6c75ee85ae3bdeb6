"""Bags with compressed images are read as those with raw ones."""

import cv2
import numpy as np
import pytest
from bags import brightness, record_episode
from rosbags.rosbag2 import StoragePlugin, Writer

from np_description.message_arrays import image_array
from np_record.bag import BagError, Recording
from np_record.cdr import TYPESTORE, serialize

RAW = "camera/image_raw"
COMPRESSED = "sensor_msgs/msg/CompressedImage"


def with_compressed(bag, path, *, topic=f"/{RAW}/compressed", text="rgb8; jpeg compressed bgr8", keep_raw=False):
    """A bag of the joint states and images of another, its images also compressed, and darker by 20."""
    kind = TYPESTORE.types[COMPRESSED]
    with Recording(bag) as recording, Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        images = writer.add_connection(topic, COMPRESSED, typestore=TYPESTORE)
        names = ("joint_states", *([RAW] if keep_raw else []))
        rest = {
            name: writer.add_connection(f"/{name}", recording.rows(name)[name].topic.type, typestore=TYPESTORE)
            for name in names
        }
        for message in recording.messages("joint_states", RAW):
            if message.topic.name in rest:
                writer.write(rest[message.topic.name], message.stamp, message.data)
            if message.topic.name == RAW:
                image = message.decode()
                data = cv2.imencode(".jpg", image_array(image)[..., ::-1] - np.uint8(20))[1].ravel()
                writer.write(images, message.stamp, serialize(kind(image.header, text, data)))
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return record_episode(tmp_path_factory.mktemp("compressed") / "bag", 300)


def read(path):
    with Recording(path) as recording:
        return [(stamp, float(pixels.mean())) for stamp, pixels in recording.read(RAW, image_array)]


@pytest.mark.parametrize("topic", [f"/{RAW}", f"/{RAW}/compressed"])
def test_compressed_images_are_read(bag, tmp_path, topic):
    expected = [(100_000_000 * i, pytest.approx(brightness(i) - 20, abs=1)) for i in range(6)]
    assert read(with_compressed(bag, tmp_path / "bag", topic=topic)) == expected


def test_raw_images_come_first(bag, tmp_path):
    assert read(with_compressed(bag, tmp_path / "bag", keep_raw=True)) == read(bag)


def test_a_format_that_is_not_read_is_named_to_who_wants_images(bag, tmp_path):
    path = with_compressed(bag, tmp_path / "bag", text="h264")
    with Recording(path) as recording:
        assert recording.start == 0 and len(recording.rows("joint_states")["joint_states"]) == 300
    with pytest.raises(BagError, match="CompressedImage.format: expected jpeg or png .*, got 'h264'"):
        read(path)
