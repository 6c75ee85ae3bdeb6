"""When a message was sent, by a steady clock."""

from __future__ import annotations

import time

_FRESH = 1_000_000_000  # ns from sending to arrival of a message that is not an old latched one


class SentTime:
    """Changes wall times of sending to this computer's steady clock.

    Only a message that arrives at once shows how the clocks stand to each other. An old latched one may be from before the
    wall clock was set, and is compared as the messages before it were.
    """

    def __init__(self) -> None:
        self._lead = time.time_ns() - time.monotonic_ns()

    def steady(self, wall: int) -> int:
        """Steady time, ns, of a message sent at a wall time, ns."""
        now = time.time_ns()
        if 0 <= now - wall < _FRESH:
            self._lead = now - time.monotonic_ns()
        return wall - self._lead
