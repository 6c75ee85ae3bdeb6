"""Reading bags, with errors that say what was expected, and a digest of what lockstep must reproduce.

A message's time is the time of its acquisition: its header's stamp, where its topic has one. The log time is that of arrival, by the
clock of whoever recorded; it dates only messages without a stamp, and only where it runs with the stamps of the other messages.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from np_record.bag_files import BagError, BagFiles, Place
from np_record.cdr import deserialize, header_stamp
from np_record.topics import BY_NAME, FORMER, RANK, TIMELINE, TOPICS, Topic

SAME_CLOCK = 50_000_000
"""ns by which log times may lie off the stamps, but for a constant delay of as much, where both are of one clock."""

_SHARE = 0.95  # of the messages must lie within SAME_CLOCK


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


@dataclass(frozen=True, eq=False)
class _Part:
    """The messages of a topic from one connection of one file, in the order in which they are stored."""

    log: np.ndarray
    """(n,) ns of arrival."""
    header: np.ndarray
    """(n,) ns of acquisition, zeros where the messages have no stamp."""


class Recording:
    """A bag with topics of the contract, checked to be complete.

    counts: messages by topic name. Raises BagError for a path that is no bag or a bag that was cut off, MissingTopics for one
    without the topics in `required`. A topic of the contract's name and another type counts as none.
    """

    def __init__(self, path: str | Path, required: Collection[str] = ()):
        self.path = Path(path)
        self._files = BagFiles(self.path)
        self.counts = self._files.counts
        self._parts: dict[str, dict[Place, _Part]] = {}
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
        """What the recorder knew of the run, {} where it said nothing. Raises BagError for what is no JSON object."""
        return self._files.information

    @property
    def information_or_none(self) -> dict:
        """`information` for whom it tells more, not less: {} where it cannot be read."""
        try:
            return self.information
        except BagError:
            return {}

    @cached_property
    def start(self) -> int:
        """ns of the first message of the contract."""
        return self._span[0]

    @cached_property
    def end(self) -> int:
        """ns of the last message of the contract."""
        return self._span[1]

    def messages(self, *names: str) -> Iterator[Message]:
        """The messages of the named topics (all if none is named), in the order of their time.

        Messages of one time come in the causal order of their topics. Raises BagError where one cannot be read, or has no time (see
        the module).
        """
        places = self._places([name for name in names or self.counts if self.counts.get(name)])
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
        self._look_at([name])
        parts = self._parts[name].values()
        return np.concatenate([part.header for part in parts]), np.concatenate([part.log for part in parts])

    def digest(self) -> str:
        """SHA-256 (hex) over (topic, time, bytes) of every message that a lockstep run must reproduce."""
        names = [topic.name for topic in (*TOPICS, *FORMER) if topic.reproducible and topic.name in self.counts]
        total = hashlib.sha256()
        for message in self.messages(*names):
            total.update(f"{message.topic.name} {message.stamp} {len(message.data)}\n".encode())
            total.update(message.data)
        return total.hexdigest()

    # Time

    @cached_property
    def _span(self) -> tuple[int, int]:
        names = [name for name in self.counts if self.counts[name]]
        self._look_at(names)
        stamps = [
            s
            for name in names
            if self._has_stamps(name) or self._delay is not None
            for s in self._stamps(name).values()
        ]
        return min(int(s.min()) for s in stamps), max(int(s.max()) for s in stamps)

    def _places(self, names: Collection[str]) -> dict[tuple[str, Place], Iterator[tuple[int, int]]]:
        """(place, stamp ns) of each stored message of these topics, by topic and connection."""
        self._look_at(names)
        stamps = {(name, key): part for name in names for key, part in self._stamps(name).items()}
        if not stamps:
            return {}
        ranks = np.concatenate([np.full(len(part), RANK[BY_NAME[name]]) for (name, _), part in stamps.items()])
        places = np.empty(len(ranks), int)
        places[np.lexsort((ranks, np.concatenate([*stamps.values()])))] = np.arange(len(ranks))
        ends = np.cumsum([len(part) for part in stamps.values()])
        parts = np.split(places, ends[:-1])
        return {key: zip(own.tolist(), stamps[key].tolist()) for key, own in zip(stamps, parts)}

    def _stamps(self, name: str) -> dict[Place, np.ndarray]:
        """Time (n,) ns of the messages of a topic by connection. Raises BagError where they have none."""
        self._look_at([name])
        parts = self._parts[name]
        if self._has_stamps(name):
            return {key: part.header for key, part in parts.items()}
        if self._delay is None:
            delays = self._delays / 1e9
            raise BagError(
                f"bag {self.path}: {name}: expected messages with a stamp, or log times by the clock of the stamps: they have no "
                f"stamp, and {self._clock} is logged {delays.min():.3f} to {delays.max():.3f} s after its stamps"
            )
        return {key: part.log - self._delay for key, part in parts.items()}

    def _has_stamps(self, name: str) -> bool:
        """Whether any message of the topic says when it was acquired: a driver that leaves that empty says zero in all."""
        return BY_NAME[name].stamped and (
            self.counts[name] == 1 or any(part.header.any() for part in self._parts[name].values())
        )

    @cached_property
    def _clock(self) -> str | None:
        """The topic by whose stamps log times are judged: joint states, or what else has stamps."""
        for name in sorted(self.counts, key=lambda name: name != TIMELINE.name):
            if self.counts[name]:
                self._look_at([name])
                if self._has_stamps(name):
                    return name
        return None

    @cached_property
    def _delays(self) -> np.ndarray:
        """ns by which the messages of the clock are logged after their stamps."""
        return np.concatenate([part.log - part.header for part in self._parts[self._clock].values()])

    @cached_property
    def _delay(self) -> int | None:
        """ns by which messages are usually logged after their stamps; None where log times are of another clock."""
        if self._clock is None:
            return 0
        usual = int(np.median(self._delays))
        off = np.quantile(np.abs(self._delays - usual), _SHARE)
        return usual if max(abs(usual), off) <= SAME_CLOCK else None

    def _look_at(self, names: Collection[str]) -> None:
        """Read the times of these topics, where that has not been done."""
        names = {name for name in names if name not in self._parts}
        found: dict[str, dict[Place, tuple[list[int], list[int]]]] = {name: {} for name in names}
        for key, topic, logged, data in self._files.messages(names):
            log, header = found[topic.name].setdefault(key, ([], []))
            log.append(logged)
            try:
                header.append(header_stamp(data) if topic.stamped else 0)
            except ValueError as error:
                raise BagError(f"bag {self.path}: {topic.name}: {error}") from error
        for name, parts in found.items():
            self._parts[name] = {
                key: _Part(*(np.array(column, np.int64) for column in columns)) for key, columns in parts.items()
            }

    def _age(self) -> str:
        """Of a bag with former topics: which release it is of, as it may lack what later ones have."""
        former = ", ".join(topic.name for topic in FORMER if self.counts.get(topic.name))
        revision = self.information_or_none.get("revision")
        release = f"release {revision}" if revision else "an earlier release"
        return f". With {former}, it was recorded by {release}" if former else ""
