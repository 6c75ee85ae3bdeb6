"""When the messages of a bag were acquired, and in which order they come.

A message's time is the stamp of its header, where its topic has one. The log time is that of arrival, by the clock of whoever
recorded; it dates only messages without a stamp, and only where it runs with the stamps of the other messages.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from np_record.bag_files import BagError, BagFiles, Place
from np_record.cdr import header_stamp
from np_record.topics import BY_NAME, RANK, TIMELINE

SAME_CLOCK = 50_000_000
"""ns by which log times may lie off the stamps, but for a constant delay of as much, where both are of one clock."""

_UNSET = 1_000_000_000  # ns; a clock that begins at zero sends its next stamp before
_SHARE = 0.95  # of the messages must lie within SAME_CLOCK


@dataclass(frozen=True, eq=False)
class _Part:
    """The messages of a topic from one connection of one file, in the order in which they are stored."""

    log: np.ndarray
    """(n,) ns of arrival."""
    header: np.ndarray
    """(n,) ns of acquisition, zeros where the messages have no stamp."""


class AcquisitionTimes:
    """Times of the messages of a bag's files, read when they are first used. Raises BagError for messages that have none."""

    def __init__(self, files: BagFiles):
        self._files = files
        self._parts: dict[str, dict[Place, _Part]] = {}

    @cached_property
    def span(self) -> tuple[int, int]:
        """Times ns of the first and the last message that has a stamp, or of all where none has."""
        names = [name for name in self._files.counts if self._files.counts[name]]
        self._look_at(names)
        stamps = [self._stamped(name).header for name in names if self._has_stamps(name)]
        stamps = stamps or [s for name in names for s in self._stamps(name).values()]
        return min(int(s.min()) for s in stamps), max(int(s.max()) for s in stamps)

    def order(self, names: Collection[str]) -> dict[tuple[str, Place], Iterator[tuple[int, int]]]:
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

    def stored(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """(header stamps, times of arrival) (n,) ns of a topic's messages as they are stored; stamps are 0 where messages have none."""
        self._look_at([name])
        parts = self._parts[name].values()
        return np.concatenate([part.header for part in parts]), np.concatenate([part.log for part in parts])

    def _stamps(self, name: str) -> dict[Place, np.ndarray]:
        """Time (n,) ns of the messages of a topic by connection. Raises BagError where they have none."""
        self._look_at([name])
        parts = self._parts[name]
        if self._has_stamps(name):
            return {key: part.header for key, part in parts.items()}
        if self._delay is None:
            delays = self._delays / 1e9
            raise BagError(
                f"bag {self._files.path}: {name}: expected messages with a stamp, or log times by the clock of the stamps: they have no "
                f"stamp, and {self._clock} is logged {delays.min():.3f} to {delays.max():.3f} s after its stamps"
            )
        return {key: part.log - self._delay for key, part in parts.items()}

    def _stamped(self, name: str) -> _Part:
        """The messages of a topic but those whose sender leaves the stamp empty: zero, and the others a second later or more."""
        log, header = (
            np.concatenate(columns) for columns in zip(*((p.log, p.header) for p in self._parts[name].values()))
        )
        others = header[header != 0]
        is_set = header != 0 if others.size and others.min() >= _UNSET else np.ones(len(header), bool)
        return _Part(log[is_set], header[is_set])

    def _has_stamps(self, name: str) -> bool:
        """Whether any message of the topic has a time of acquisition: a driver that does not set it leaves zero in all."""
        return BY_NAME[name].stamped and (
            self._files.counts[name] == 1 or any(part.header.any() for part in self._parts[name].values())
        )

    @cached_property
    def _clock(self) -> str | None:
        """The topic by whose stamps log times are judged: joint states, or what else has stamps."""
        for name in sorted(self._files.counts, key=lambda name: name != TIMELINE.name):
            if self._files.counts[name]:
                self._look_at([name])
                if self._has_stamps(name):
                    return name
        return None

    @cached_property
    def _delays(self) -> np.ndarray:
        """ns by which the messages of the clock are logged after their stamps."""
        part = self._stamped(self._clock)
        return part.log - part.header

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
        for key, topic, logged, data in self._files.messages(names, decompress=False):
            log, header = found[topic.name].setdefault(key, ([], []))
            log.append(logged)
            try:
                header.append(header_stamp(data) if topic.stamped else 0)
            except ValueError as error:
                raise BagError(f"bag {self._files.path}: {topic.name}: {error}") from error
        for name, parts in found.items():
            self._parts[name] = {
                key: _Part(*(np.array(column, np.int64) for column in columns)) for key, columns in parts.items()
            }
