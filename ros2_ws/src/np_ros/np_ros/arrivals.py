"""Whether what was published has arrived: in lockstep time can wait for a subscriber that gets no processor time.

A writer keeps a message until every reliable reader has it, but no more than its depth (`np_ros.qos`). At 500 messages a second
there is always one on its way, so what is looked at is when there was none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rclpy.duration import Duration
from rclpy.publisher import Publisher

_NOW = Duration(nanoseconds=0)


class Arrivals:
    """Whether messages of some publishers have arrived; within: ns of the backend's time that there may be between two looks at which all had arrived."""

    def __init__(self, publishers: Sequence[Publisher], within: int):
        self._arrived: list[Callable[[Duration], bool]] = [each.wait_for_all_acked for each in publishers]
        self._within = within
        self._last = 0

    def are_recent(self, stamp: int) -> bool:
        """Whether everything had arrived, at `stamp` ns or not long before; looks where the last time is half as long ago."""
        if stamp - self._last > self._within // 2 and all(arrived(_NOW) for arrived in self._arrived):
            self._last = stamp
        return stamp - self._last <= self._within
