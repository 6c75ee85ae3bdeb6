"""Recording: messages in any order of arrival become one bag in the order of their time.

The time of a message in the bag is its own stamp. What has no stamp (phase, gains, gripper) gets that of
the last joint state published before it. A lockstep run thus gives the same messages at the same times in
the same order on any machine at any speed; what a backend sends again while it waits (docs/reference/graph.md) is
kept once.
"""

from __future__ import annotations

import heapq
import json
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from queue import SimpleQueue
from threading import Thread

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer

from np_record.cdr import TYPESTORE, header_stamp, padding_filter
from np_record.topics import TIMELINE, TOPICS, Topic

HORIZON = 500_000_000
"""ns of the recorded clock for which a message may be overtaken: five policy ticks."""

_TIMELINE_LENGTH = 10_000
_FOREVER = QosTime(2147483647, 4294967295)


class Sequencer:
    """Orders serialized messages by time.

    emit(stamp ns, topic, data) is called in the order of (stamp, TOPICS, arrival). With `begin_at` what is
    older than the first message of that topic is left out, and nothing is emitted before it comes.
    `repeated` counts messages that came twice, `lost` the gaps in the publishers' own numbering.
    """

    def __init__(self, emit: Callable[[int, Topic, bytes], None], begin_at: Topic | None = None):
        self._emit = emit
        self._begin_at = begin_at
        self._begin = 0
        self._filters = {topic: padding_filter(topic.type) for topic in TOPICS}
        self._rank = {topic: i for i, topic in enumerate(TOPICS)}
        self._published: list[int] = []  # the timeline: when joint states were published, by the wall, ...
        self._stamps: list[int] = []  # ... and their stamps
        self._unstamped: list[tuple[int, Topic, bytes]] = []
        self._heap: list[tuple[int, int, int, Topic, bytes]] = []
        self._last: dict[Topic, tuple[int, bytes]] = {}
        self._numbers: dict[Topic, int] = {}
        self._arrivals = 0
        self.repeated = 0
        self.lost = 0

    def add(self, topic: Topic, data: bytes, published: int, number: int | None = None) -> None:
        """A message, its publisher's wall time ns and running number. Raises ValueError for broken data."""
        data = self._filters[topic](data)
        if number is not None:
            self.lost += max(0, number - self._numbers.get(topic, number - 1) - 1)
            self._numbers[topic] = number
        if not topic.stamped:
            self._unstamped.append((published, topic, data))
            self._stamp_what_waits()
            return
        stamp = header_stamp(data)
        self._place(stamp, topic, data)
        if topic is TIMELINE:
            self._published.append(published)
            self._stamps.append(stamp)
            self._stamp_what_waits()
            if len(self._stamps) > 2 * _TIMELINE_LENGTH:
                del self._published[:_TIMELINE_LENGTH], self._stamps[:_TIMELINE_LENGTH]
            while self._begin_at is None and self._heap and self._heap[0][0] < stamp - HORIZON:
                self._pop()

    def flush(self) -> None:
        """Emit everything."""
        self._stamp_what_waits(final=True)
        while self._heap:
            self._pop()

    def _stamp_what_waits(self, final: bool = False) -> None:
        waiting, self._unstamped = self._unstamped, []
        for published, topic, data in waiting:
            # Only once a later joint state is here is it sure which one was the last before.
            if final or self._published and self._published[-1] > published:
                index = bisect_right(self._published, published) - 1
                stamp = self._stamps[max(0, index)] if self._stamps else 0
                self._place(stamp, topic, data)
            else:
                self._unstamped.append((published, topic, data))

    def _place(self, stamp: int, topic: Topic, data: bytes) -> None:
        if self._last.get(topic) == (stamp, data):
            self.repeated += 1
            return
        self._last[topic] = (stamp, data)
        if topic is self._begin_at:
            self._begin, self._begin_at = stamp, None
        self._arrivals += 1
        heapq.heappush(self._heap, (stamp, self._rank[topic], self._arrivals, topic, data))

    def _pop(self) -> None:
        stamp, _, _, topic, data = heapq.heappop(self._heap)
        if stamp >= self._begin:
            self._emit(stamp, topic, data)


class BagWriter:
    """A rosbag2 bag (MCAP) with topics of the contract, written by a thread of its own.

    path: folder to make; information: stored as JSON in the bag's metadata under "run_info". Raises OSError
    where the bag cannot be made, exists already, or (from `write` and `close`) cannot be written.
    """

    def __init__(self, path: str | Path, information: Mapping[str, object], topics: Sequence[Topic] = TOPICS):
        self.path = Path(path)
        if self.path.exists():
            raise FileExistsError(f"bag {self.path}: expected a new path, it exists")
        self._writer = Writer(self.path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_custom_data("run_info", json.dumps(dict(information), sort_keys=True))
        self._writer.open()
        self._connections = {
            topic: self._writer.add_connection(
                f"/{topic.name}", topic.type, typestore=TYPESTORE, offered_qos_profiles=[_qos(topic)]
            )
            for topic in topics
        }
        self.count = 0
        self._error: OSError | None = None
        self._queue: SimpleQueue = SimpleQueue()
        self._thread = Thread(target=self._run, name="bag writer")
        self._thread.start()

    def write(self, stamp: int, topic: Topic, data: bytes) -> None:
        """Queue one serialized message with its time ns."""
        self._raise()
        self.count += 1
        self._queue.put((stamp, topic, data))

    def close(self) -> None:
        """Write what is queued, then the index; the bag is complete afterwards."""
        self._queue.put(None)
        self._thread.join()
        try:
            self._writer.close()
        except OSError as error:
            self._error = self._error or error
        self._raise()

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            if self._error is None:
                stamp, topic, data = item
                try:
                    self._writer.write(self._connections[topic], stamp, data)
                except OSError as error:  # a full disk; keep taking, so that the caller learns of it
                    self._error = error

    def _raise(self) -> None:
        if self._error is not None:
            raise OSError(f"bag {self.path}: cannot be written: {self._error}") from self._error


def _qos(topic: Topic) -> Qos:
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if topic.latched else 100,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if topic.latched else QosDurability.VOLATILE,
        deadline=_FOREVER,
        lifespan=_FOREVER,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_FOREVER,
        avoid_ros_namespace_conventions=False,
    )
