"""Recording: messages in any order of arrival become one bag in the order of their time.

The time of a message in the bag is its own stamp. What has no stamp (phase, gains, gripper) gets that of
the last joint state published before it. A lockstep run thus gives the same messages at the same times in
the same order on any machine at any speed; what a backend sends again while it waits (docs/reference/graph.md) is
kept once.
"""

from __future__ import annotations

import heapq
from bisect import bisect_right
from collections.abc import Callable

from np_record.cdr import header_stamp, padding_filter
from np_record.topics import RANK, TIMELINE, TOPICS, Topic

HORIZON = 3_000_000_000
"""ns of the recorded clock for which a message may be overtaken: a second more than lockstep goes on while one is sent again."""

_TIMELINE_LENGTH = 10_000


class Sequencer:
    """Orders serialized messages by time.

    emit(stamp ns, topic, data) is called in the order of (stamp, TOPICS, arrival). With `begin_at` what is
    older than the first message of that topic is left out, and nothing is emitted before it comes.
    `repeated` counts messages that came twice. `lost` counts the gaps in the publishers' own numbering, and messages left out
    after a restart of the backend: its time begins anew, before that of the bag.
    """

    def __init__(self, emit: Callable[[int, Topic, bytes], None], begin_at: Topic | None = None):
        self._emit = emit
        self._begin_at = begin_at
        self._begin = 0
        self._filters = {topic: padding_filter(topic.type) for topic in TOPICS}
        self._published: list[int] = []  # the timeline: when joint states were published, never decreasing, ...
        self._stamps: list[int] = []  # ... and their stamps
        # ns by which the wall clock was set back in all, and before the last time.
        self._set_back = self._set_back_before = 0
        self._unstamped: list[tuple[int, Topic, bytes]] = []
        self._heap: list[tuple[int, int, int, Topic, bytes]] = []
        self._last: dict[Topic, tuple[int, bytes]] = {}
        self._numbers: dict[Topic, int] = {}
        self._arrivals = 0
        self._is_restarted = False
        self.repeated = 0
        self.lost = 0

    def add(self, topic: Topic, data: bytes, published: int, number: int | None = None) -> None:
        """A message, its publisher's wall time ns and running number. Raises ValueError for broken data."""
        data = self._filters[topic](data)
        if number is not None:
            self.lost += max(0, number - self._numbers.get(topic, number - 1) - 1)
            self._numbers[topic] = number
        if not topic.stamped:
            # Only the next joint state shows whether the clock was set back meanwhile.
            self._unstamped.append((published, topic, data))
            return
        stamp = header_stamp(data)
        self._place(stamp, topic, data)
        if topic is TIMELINE:
            self._is_restarted |= bool(self._stamps) and stamp < self._stamps[-1]
            self._note_published(published)
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

    def _note_published(self, wall: int) -> None:
        """Continue the timeline; joint states come in their order, so that an earlier wall time is a clock set back."""
        last = self._published[-1] if self._published else wall
        if wall + self._set_back < last:
            self._set_back_before, self._set_back = self._set_back, last - wall
        self._published.append(wall + self._set_back)

    def _time_published(self, wall: int) -> int:
        """A wall time on the timeline, ns: by the clock as it is now, or as it was before, whichever is nearer to the end."""
        times = wall + self._set_back, wall + self._set_back_before
        return min(times, key=lambda time: abs(time - self._published[-1])) if self._published else wall

    def _stamp_what_waits(self, final: bool = False) -> None:
        waiting, self._unstamped = self._unstamped, []
        for wall, topic, data in waiting:
            published = self._time_published(wall)
            # Only once a later joint state is here is it sure which one was the last before.
            if final or self._published[-1] > published:
                index = bisect_right(self._published, published) - 1
                stamp = self._stamps[max(0, index)] if self._stamps else 0
                self._place(stamp, topic, data)
            else:
                self._unstamped.append((wall, topic, data))

    def _place(self, stamp: int, topic: Topic, data: bytes) -> None:
        if self._last.get(topic) == (stamp, data):
            self.repeated += 1
            return
        self._last[topic] = (stamp, data)
        if topic is self._begin_at:
            self._begin, self._begin_at = stamp, None
        self._arrivals += 1
        heapq.heappush(self._heap, (stamp, RANK[topic], self._arrivals, topic, data))

    def _pop(self) -> None:
        stamp, _, _, topic, data = heapq.heappop(self._heap)
        if stamp >= self._begin:
            self._emit(stamp, topic, data)
        else:
            self.lost += self._is_restarted
