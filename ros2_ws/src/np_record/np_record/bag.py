"""Reading bags, with errors that state what was expected, and a digest of what lockstep must reproduce."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from np_record.acquisition_time import AcquisitionTimes
from np_record.bag_files import BagError, BagFiles
from np_record.cdr import deserialize
from np_record.topics import BY_NAME, FORMER, TOPICS, Topic


class MissingTopics(BagError):
    """A bag without messages on required topics; information: the recorder's run_info."""

    def __init__(self, text: str, information: dict):
        super().__init__(text)
        self.information = information


class Message(NamedTuple):
    """One recorded message: its time ns, its topic, its serialized bytes. Made 1,500 times for a second of recording."""

    stamp: int
    topic: Topic
    data: bytes

    def decode(self):
        """The message as an object with the fields of its ROS type. Raises BagError where its bytes make none."""
        try:
            return deserialize(self.data, self.topic.type)
        except Exception as error:  # damaged bytes end in any of a dozen types of exception
            raise BagError(
                f"{self.topic.name} at {self.stamp} ns: expected a readable message, got: {error}"
            ) from error


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

    counts: messages by topic name. Raises BagError for a path that is no bag or a bag that was cut off, MissingTopics for one
    without the topics in `required`. A topic of the contract's name and another type counts as none.
    """

    def __init__(self, path: str | Path, required: Collection[str] = ()):
        self.path = Path(path)
        self._files = BagFiles(self.path)
        self.counts = self._files.counts
        self._times = AcquisitionTimes(self._files)
        missing = [name for name in required if not self.counts.get(name)]
        if missing or not any(self.counts.values()):
            wanted = ", ".join(missing) or "the topics of docs/reference/graph.md"
            raise MissingTopics(
                f"bag {self.path}: expected messages on {wanted}; it has {self._files.describe()}{self._age()}",
                self.information_or_none,
            )

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._files.close()

    @property
    def information(self) -> dict:
        """The recorder's run_info, {} where there is none. Raises BagError for what is no JSON object."""
        return self._files.information

    @property
    def information_or_none(self) -> dict:
        """`information`, {} where it cannot be read: for those who can do without."""
        try:
            return self.information
        except BagError:
            return {}

    @property
    def start(self) -> int:
        """ns of the first message of the contract."""
        return self._times.span[0]

    @property
    def end(self) -> int:
        """ns of the last message of the contract."""
        return self._times.span[1]

    def messages(self, *names: str) -> Iterator[Message]:
        """The messages of the named topics (all if none is named), in the order of their time.

        Messages of one time come in the causal order of their topics. Raises BagError where one cannot be read, or has no time (see `acquisition_time`).
        """
        places = self._times.order([name for name in names or self.counts if self.counts.get(name)])
        waiting: dict[int, Message] = {}
        due = 0
        for key, topic, _, data in self._files.messages({name for name, _ in places}):
            place, stamp = next(places[topic.name, key])
            waiting[place] = Message(stamp, topic, data)
            while due in waiting:
                yield waiting.pop(due)
                due += 1

    def rows(self, *names: str) -> dict[str, TopicMessages]:
        """The messages of each named topic that the bag has. Raises BagError as `messages`."""
        found: dict[str, tuple[Topic, list[int], list[bytes]]] = {
            name: (BY_NAME[name], [], []) for name in names if name in self.counts
        }
        for message in self.messages(*found) if found else ():
            _, stamps, data = found[message.topic.name]
            stamps.append(message.stamp)
            data.append(message.data)
        return {
            name: TopicMessages(topic, np.array(stamps, np.int64), data)
            for name, (topic, stamps, data) in found.items()
        }

    def read(self, name: str, function: Callable) -> Iterator[tuple[int, object]]:
        """(time ns, what `function` makes of the decoded message) of a topic's messages. Raises BagError where that raises ValueError."""
        for message in self.messages(name):
            try:
                yield message.stamp, function(message.decode())
            except BagError as error:
                raise BagError(f"bag {self.path}: {error}") from error
            except ValueError as error:
                raise BagError(f"bag {self.path}: {name} at {message.stamp} ns: {error}") from error

    def times(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """(header stamps, times of arrival) (n,) ns of a topic's messages as they are stored; stamps are 0 where messages have none."""
        return self._times.stored(name)

    def digest(self) -> str:
        """SHA-256 (hex) over (topic, time, bytes) of every message that a lockstep run must reproduce."""
        names = [topic.name for topic in (*TOPICS, *FORMER) if topic.reproducible and topic.name in self.counts]
        total = hashlib.sha256()
        for message in self.messages(*names):
            total.update(f"{message.topic.name} {message.stamp} {len(message.data)}\n".encode())
            total.update(message.data)
        return total.hexdigest()

    def _age(self) -> str:
        """Of a bag with former topics: which release it is of, as it may lack what later ones have."""
        former = ", ".join(topic.name for topic in FORMER if self.counts.get(topic.name))
        revision = self.information_or_none.get("revision")
        release = f"release {revision}" if revision else "an earlier release"
        return f". With {former}, it was recorded by {release}" if former else ""
