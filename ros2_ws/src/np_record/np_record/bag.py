"""Reading bags, with errors that say what was expected, and a digest of what lockstep must reproduce."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rosbags.rosbag2 import Reader

from np_record.cdr import TYPESTORE
from np_record.topics import BY_NAME, FORMER, TOPICS, Topic


class BagError(ValueError):
    """A bag that cannot be used; the text says what was expected and what was found."""


class MissingTopics(BagError):
    """A bag without messages on topics that were asked for; information: what the recorder knew of the run."""

    def __init__(self, text: str, information: dict):
        super().__init__(text)
        self.information = information


class Message(NamedTuple):
    """One recorded message: its time ns, its topic, its serialized bytes. Made 1,500 times for a second of recording."""

    stamp: int
    topic: Topic
    data: bytes

    def decode(self):
        """The message as an object with the fields of its ROS type."""
        return TYPESTORE.deserialize_cdr(self.data, self.topic.type)


@dataclass(frozen=True, eq=False)
class TopicMessages:
    """The messages of one topic as a sequence, in the order of their time."""

    topic: Topic
    """Their topic."""
    stamp: np.ndarray
    """(n,) ns."""
    data: list[bytes]
    """Their serialized bytes, n of them."""

    def __len__(self) -> int:
        return len(self.stamp)

    def __getitem__(self, number: int) -> Message:
        return Message(int(self.stamp[number]), self.topic, self.data[number])


class Recording:
    """A bag with topics of the contract, checked to be complete.

    counts: messages by topic name; information: what the recorder knew of the run; start, end: ns. Raises
    BagError for a path that is no bag or a bag that was cut off, MissingTopics for one without the topics in `required`.
    """

    def __init__(self, path: str | Path, required: Collection[str] = ()):
        self.path = Path(path)
        self._reader = self._open()
        self._topics = {}
        for connection in self._reader.connections:
            topic = BY_NAME.get(connection.topic.lstrip("/"))
            if topic is None:
                continue
            if connection.msgtype != topic.type:
                raise BagError(f"bag {self.path}: topic {topic.name}: expected {topic.type}, got {connection.msgtype}")
            self._topics[connection.id] = (topic, connection)
        self.counts = {topic.name: connection.msgcount for topic, connection in self._topics.values()}
        custom = getattr(self._reader.storage.metadata, "custom", None) or {}
        self.information: dict = json.loads(custom.get("run_info", "{}"))
        missing = [name for name in required if not self.counts.get(name)]
        if missing or not any(self.counts.values()):
            found = [
                f"{c.topic} ({c.msgcount})"
                if c.topic.lstrip("/") in BY_NAME
                else f"{c.topic} ({c.msgtype}, {c.msgcount})"
                for c in self._reader.connections
                if c.msgcount
            ]
            wanted = ", ".join(missing) or "the topics of docs/reference/graph.md"
            raise MissingTopics(
                f"bag {self.path}: expected messages on {wanted}; it has {', '.join(found) or 'none at all'}{self._age()}",
                self.information,
            )
        self.start, self.end = self._reader.start_time, self._reader.end_time - 1

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._reader.close()

    def messages(self, *names: str) -> Iterator[Message]:
        """The messages of the named topics (all if none is named), in the order of their time."""
        wanted = [c for topic, c in self._topics.values() if not names or topic.name in names]
        try:
            for connection, stamp, data in self._reader.messages(wanted) if wanted else ():
                yield Message(stamp, self._topics[connection.id][0], bytes(data))
        except Exception as error:  # damaged bytes end in any of a dozen types of exception
            raise self._unreadable(error) from error

    def rows(self, *names: str) -> dict[str, TopicMessages]:
        """The messages of each named topic that the bag has."""
        wanted = {c.id: (topic, c) for topic, c in self._topics.values() if topic.name in names}
        columns: dict[int, tuple[list[int], list[bytes]]] = {number: ([], []) for number in wanted}
        try:
            for connection, stamp, data in self._reader.messages([c for _, c in wanted.values()]) if wanted else ():
                stamps, messages = columns[connection.id]
                stamps.append(stamp)
                messages.append(data)
        except Exception as error:
            raise self._unreadable(error) from error
        return {
            topic.name: TopicMessages(topic, np.array(columns[number][0], np.int64), columns[number][1])
            for number, (topic, _) in wanted.items()
        }

    def _age(self) -> str:
        """Of a bag with former topics: which release it is of, as it may lack what later ones have."""
        former = ", ".join(topic.name for topic in FORMER if self.counts.get(topic.name))
        revision = self.information.get("revision")
        release = f"release {revision}" if revision else "an earlier release"
        return f". With {former}, it was recorded by {release}" if former else ""

    def _unreadable(self, error: Exception) -> BagError:
        return BagError(f"bag {self.path}: expected readable messages to the end, got: {error}")

    def digest(self) -> str:
        """SHA-256 (hex) over (topic, time, bytes) of every message that a lockstep run must reproduce."""
        names = [topic.name for topic in (*TOPICS, *FORMER) if topic.reproducible and topic.name in self.counts]
        total = hashlib.sha256()
        for message in self.messages(*names):
            total.update(f"{message.topic.name} {message.stamp} {len(message.data)}\n".encode())
            total.update(message.data)
        return total.hexdigest()

    def _open(self) -> Reader:
        if not self.path.exists():
            raise BagError(
                f"bag {self.path}: expected a folder with metadata.yaml and an .mcap file, it does not exist"
            )
        if self.path.is_dir() and not (self.path / "metadata.yaml").exists():
            inside = sorted(p.name for p in self.path.iterdir())
            raise BagError(
                f"bag {self.path}: expected metadata.yaml, which the recorder writes when it closes the bag; "
                f"found {inside or 'an empty folder'}: the recording was cut off, or this is no bag"
            )
        try:
            reader = Reader(self.path)
            reader.open()
        except Exception as error:
            raise BagError(
                f"bag {self.path}: expected a complete rosbag2 recording, got: {error} (cut off, or no bag)"
            ) from error
        return reader
