"""The files of a bag: which topics of the contract they hold, and their messages as they are stored."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from functools import cached_property
from pathlib import Path

from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import zstd

from np_description.message_arrays import decode_compressed_image
from np_record.cdr import TYPESTORE, deserialize, serialize, to_little_endian
from np_record.topics import BY_NAME, Topic

Place = tuple[int, int]
"""Number of a file, connection in it."""

_COMPRESSED = "sensor_msgs/msg/CompressedImage"
_IMAGE = "sensor_msgs/msg/Image"
_ZSTD = b"\x28\xb5\x2f\xfd"  # with which a compressed message begins; a serialized one begins with a zero


class BagError(ValueError):
    """A bag that cannot be used; the text states what was expected and what was found."""


class BagFiles:
    """The files of a bag. Raises BagError for a path that is no bag, or a bag that was cut off.

    counts: messages by name of the contract's topics. A topic of that name and of another type counts as none. Compressed images are
    an exception, also those of image_transport's topic `.../compressed`: they are returned as Image where the bag has no raw ones.
    """

    def __init__(self, path: Path):
        self.path = path
        self._reader = _open(path)
        # Each file by itself: the reader of the whole passes over files whose QoS is not that in metadata.yaml.
        self._storages = getattr(self._reader.storage, "storages", [self._reader.storage])
        self.counts: dict[str, int] = {}
        self._raw = {_name(c) for c in self._connections() if c.msgtype == _IMAGE and c.msgcount}
        for connection in self._connections():
            if self._is_read(connection):
                self.counts[_name(connection)] = self.counts.get(_name(connection), 0) + connection.msgcount

    def close(self) -> None:
        """Close the files."""
        self._reader.close()

    @cached_property
    def information(self) -> dict:
        """The recorder's run_info, {} where there is none. Raises BagError for what is no JSON object."""
        text = (getattr(self._reader.storage.metadata, "custom", None) or {}).get("run_info", "{}")
        try:
            found = json.loads(text)
        except (TypeError, ValueError):
            found = None
        if not isinstance(found, dict):
            raise BagError(f"bag {self.path}: expected a JSON object as run_info in its custom data, got {text!r}")
        return found

    def messages(self, names: Collection[str], *, decompress: bool = True) -> Iterator[tuple[Place, Topic, int, bytes]]:
        """(place, topic, log time ns, bytes) of the messages of these topics as they are stored. Raises BagError.

        decompress: CompressedImage as Image; without it their headers alone are those of the topic's type.
        """
        for number, storage in enumerate(self._storages):
            wanted = [c for c in storage.connections if self._is_read(c) and _name(c) in names]
            topics = {c.id: BY_NAME[_name(c)] for c in wanted}
            compressed = {c.id for c in wanted if decompress and c.msgtype == _COMPRESSED}
            try:
                for connection, logged, data in storage.messages(wanted) if wanted else ():
                    topic = topics[connection.id]
                    data = zstd.decompress(data) if data[:4] == _ZSTD else bytes(data)
                    data = to_little_endian(data, connection.msgtype)
                    data = _decompress(data) if connection.id in compressed else data
                    yield (number, connection.id), topic, logged, data
            except Exception as error:  # damaged bytes end in any of a dozen types of exception
                raise BagError(f"bag {self.path}: expected readable messages to the end, got: {error}") from error

    def describe(self) -> str:
        """The topics that have messages, with their types where the contract has no such topic."""
        counts: dict[str, int] = {}
        for c in self._connections():
            expected = BY_NAME.get(_name(c))
            kind = "" if self._is_read(c) else f"{c.msgtype}, expected {expected.type}" if expected else c.msgtype
            counts[f"{c.topic} ({kind}"] = counts.get(f"{c.topic} ({kind}", 0) + c.msgcount
        found = [f"{text}{', ' * (text[-1] != '(')}{count})" for text, count in counts.items() if count]
        return ", ".join(found) or "none at all"

    def _is_read(self, connection) -> bool:
        topic = BY_NAME.get(_name(connection))
        if topic is None:
            return False
        is_needed = topic.type == _IMAGE and topic.name not in self._raw
        return connection.msgtype == topic.type or (connection.msgtype == _COMPRESSED and is_needed)

    def _connections(self):
        return [connection for storage in self._storages for connection in storage.connections]


def _name(connection) -> str:
    name = connection.topic.lstrip("/")
    return name.removesuffix("/compressed") if connection.msgtype == _COMPRESSED else name


def _decompress(data: bytes) -> bytes:
    """A serialized Image of a serialized CompressedImage. Raises BadMessage."""
    message = deserialize(data, _COMPRESSED)
    pixels = decode_compressed_image(message)
    height, width = pixels.shape[:2]
    image = TYPESTORE.types[_IMAGE](message.header, height, width, "rgb8", 0, 3 * width, pixels.ravel())
    return serialize(image)


def _open(path: Path) -> Reader:
    if not path.exists():
        raise BagError(f"bag {path}: expected a folder with metadata.yaml and an .mcap file, it does not exist")
    if path.is_dir() and not (path / "metadata.yaml").exists():
        inside = sorted(p.name for p in path.iterdir())
        raise BagError(
            f"bag {path}: expected metadata.yaml, which the recorder writes when it closes the bag; "
            f"found {inside or 'an empty folder'}: the recording was cut off, or this is no bag"
        )
    try:
        reader = Reader(path)
        reader.open()
    except Exception as error:
        raise BagError(
            f"bag {path}: expected a complete rosbag2 recording, got: {error} (cut off, or no bag)"
        ) from error
    return reader
