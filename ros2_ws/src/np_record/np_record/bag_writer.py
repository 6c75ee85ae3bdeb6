"""Writing one bag, so that what was written can be read, also where the disk has become full meanwhile."""

from __future__ import annotations

import io
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from threading import Thread

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer

from np_record.cdr import TYPESTORE
from np_record.topics import TOPICS, Topic

INCOMPLETE = "incomplete"
"""Key of a recording's information: why it ends early."""

_FOREVER = QosTime(2147483647, 4294967295)
_ROOM = 4 << 20  # bytes kept free for the end of a bag: a chunk and the index of ten thousand more


class BagWriter:
    """A rosbag2 bag (MCAP) with topics of the contract, written by a thread of its own.

    path: folder to make; information: stored as JSON in the bag's metadata under "run_info". Raises OSError
    where the bag cannot be made, exists already, or (from `write` and `close`) cannot be written. A bag that cannot be
    written further is closed with the chunks (1 MB) that it has, and `INCOMPLETE` in its information.
    """

    def __init__(self, path: str | Path, information: Mapping[str, object], topics: Sequence[Topic] = TOPICS):
        self.path = Path(path)
        if self.path.exists():
            raise FileExistsError(f"bag {self.path}: expected a new path, it exists")
        self._information = dict(information)
        self._writer = Writer(self.path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
        self._tell_information()
        try:
            begun = self._begin(topics)
        except OSError as error:
            self._leave_nothing()
            raise OSError(f"bag {self.path}: cannot be made: {error.strerror}") from error
        self.count = 0
        self._kept = begun, 0, 0  # bytes, chunks and ns up to which the file is whole
        self._newest = 0
        self._error: OSError | None = None
        self._end = ""
        self._queue: SimpleQueue = SimpleQueue()
        self._thread = Thread(target=self._run, name="bag writer")
        self._thread.start()

    def _begin(self, topics: Sequence[Topic]) -> int:
        """Make the bag, with room for its end; the place at which its messages begin. Raises OSError."""
        self._room = self.path / ".room"
        self._writer.open()
        with self._room.open("wb") as room:
            os.posix_fallocate(room.fileno(), 0, _ROOM)
        self._storage = self._writer.storage
        self._storage.bio.flush()
        begun = self._storage.bio.tell()
        self._storage.bio.close()
        self._storage.bio = _Unbuffered(self._storage.path, "r+")
        self._storage.bio.seek(begun)
        self._connections = {
            topic: self._writer.add_connection(
                f"/{topic.name}", topic.type, typestore=TYPESTORE, offered_qos_profiles=[_qos(topic)]
            )
            for topic in topics
        }
        return begun

    def _leave_nothing(self) -> None:
        """Remove a bag that was not begun: a folder without messages and metadata.yaml is none."""
        with suppress(OSError):  # where even what was buffered has no place
            self._writer.abort()
        shutil.rmtree(self.path, ignore_errors=True)

    @property
    def has_failed(self) -> bool:
        """Whether it cannot be written further: `write` and `close` raise why."""
        return self._error is not None

    def write(self, stamp: int, topic: Topic, data: bytes) -> None:
        """Queue one serialized message with its time ns."""
        self._raise()
        self.count += 1
        self._queue.put((stamp, topic, data))

    def close(self) -> None:
        """Write what is queued, then the index; the bag is complete afterwards."""
        self._queue.put(None)
        self._thread.join()
        self._raise()

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            if self._error is None:
                stamp, topic, data = item
                try:
                    self._newest = stamp
                    self._writer.write(self._connections[topic], stamp, data)
                    self._mark()
                except OSError as error:  # a full disk; keep taking, so that the caller learns of it
                    self._give_up(error)
        if self._error is None:
            try:
                if self._storage.chunk.bio.tell():
                    self._storage.close_chunk()
                    self._mark()
            except OSError as error:
                self._give_up(error)
            else:
                self._finish()

    def _mark(self) -> None:
        """Remember where the file is whole, if another chunk is."""
        if len(self._storage.chunks) > self._kept[1]:
            self._kept = self._storage.bio.tell(), len(self._storage.chunks), self._newest

    def _give_up(self, error: OSError) -> None:
        """Close the bag after its last whole chunk."""
        storage, writer = self._storage, self._writer
        place, _, newest = self._kept
        storage.bio.seek(place)
        storage.bio.truncate()
        for channel, messages in storage.chunk.msgs.items():
            storage.channel_stats[channel] -= len(messages)
        storage.chunk.bio.seek(0)
        storage.chunk.bio.truncate()
        storage.chunk.msgs.clear()
        storage.message_end_time = writer.max_timestamp = newest
        writer.counts.update(storage.channel_stats)
        kept = sum(writer.counts.values())
        self._information[INCOMPLETE] = f"{error.strerror}, after {kept} messages"
        self._tell_information()
        self._end = f"; it ends early, readable, with {kept} messages"
        self._finish()
        self._error = error

    def _finish(self) -> None:
        """Index and metadata.yaml, in the room that was kept for them."""
        try:
            self._room.unlink()
            self._writer.close()
        except OSError as error:
            self._writer.abort()
            self._end = "; it is incomplete: without index or metadata.yaml"
            self._error = error

    def _tell_information(self) -> None:
        self._writer.set_custom_data("run_info", json.dumps(self._information, sort_keys=True))

    def _raise(self) -> None:
        if self._error is not None:
            raise OSError(f"bag {self.path}: cannot be written: {self._error.strerror}{self._end}") from self._error


class _Unbuffered(io.FileIO):
    """A file to which a write is whole, or raises: a buffered write fails later, after an unknown part of it."""

    def write(self, data) -> int:
        rest = memoryview(data).cast("B")
        while rest:
            rest = rest[super().write(rest) :]
        return len(data)


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
