"""How long the robot's cycles took, over a whole run, at a cost that does not grow with it."""

from __future__ import annotations

import numpy as np

RESOLUTION = 1e-5  # s
LONGEST = 0.1  # s, beyond which only the longest is known exactly


class CycleTimes:
    """Counts cycles by their length."""

    def __init__(self):
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self._counts = np.zeros(round(LONGEST / RESOLUTION) + 1, dtype=np.int64)
        self._total, self.longest = 0.0, 0.0

    def add(self, seconds: float) -> None:
        """Count one cycle."""
        self._counts[min(int(seconds / RESOLUTION), len(self._counts) - 1)] += 1
        self._total += seconds
        if seconds > self.longest:
            self.longest = seconds

    @property
    def count(self) -> int:
        """Cycles counted."""
        return int(self._counts.sum())

    @property
    def rate(self) -> float:
        """Cycles a second; 0 before the first."""
        return self.count / self._total if self._total else 0.0

    def percentile(self, percent: float) -> float:
        """Length s that `percent` of the cycles did not exceed, to 10 us; beyond LONGEST that of the longest;
        0 before the first.
        """
        if not self._total:
            return 0.0
        cumulative = np.cumsum(self._counts)
        index = int(np.searchsorted(cumulative, max(1, np.ceil(percent / 100 * cumulative[-1] - 1e-9))))
        is_longer = index == len(self._counts) - 1
        return self.longest if is_longer else min((index + 1) * RESOLUTION, self.longest)
