"""From the camera's clock to the host's, by the frames' times of arrival alone.

A frame arrives after it was taken, by the host's clock, with a delay that has a least value and is now and then
much more. So the arrivals lie above a line, whose slope is the drift of one clock against the other. The line is
the lower edge of their convex hull (Zhang, Liu and Xia, "Clock synchronization algorithms for network
measurements", INFOCOM 2002). Late frames, however many and however late, do not move it. The least delay itself
cannot be measured: it stays in the stamps (docs/guide/hardware.md).
"""

from __future__ import annotations

from collections import deque

from np_description.control_rate import SECOND

WINDOW = 60 * SECOND  # of the camera's clock that the line is fitted to
BIN = SECOND // 2  # of which the earliest arrival is kept
SETTLED = 10 * SECOND  # from which on the drift is fitted too: before, any delay would be taken for drift
MAX_DRIFT = 200e-6  # quartz is better than 100 ppm
# Between what came and what was expected, from which on a clock was set and a frame is not only late
JUMP = SECOND // 4
PATIENCE = 30  # frames in a row that may come later than that


class ClockMapper:
    """Maps times of one clock, as they arrive, to another's. Times are integers of nanoseconds.

    wraps: after how many ns the camera's counter begins anew, or 0. What it returns grows strictly and is
    never later than the arrival; only where the host's clock was set back it begins anew. restarts: how often
    a clock was set; drift: what the host's clock gains on the camera's, s/s.
    """

    def __init__(self, wraps: int = 0) -> None:
        self._wraps = wraps
        self._last_stamp = -1
        self.restarts = 0
        self._begin()

    def map(self, device: int, arrival: int) -> int:
        """The host's time at which a frame was taken that has the camera's time `device` and came at
        `arrival`."""
        device = self._unwrap(device)
        if self._newest is not None and self._was_set(device, arrival):
            self.restarts += 1
            self._begin()
            if arrival <= self._last_stamp:
                self._last_stamp = -1
        self._newest = device
        self._add(device, arrival - device)
        stamp = min(device + self._predict(device), arrival)
        self._last_stamp = max(stamp, self._last_stamp + 1)
        return self._last_stamp

    def _begin(self) -> None:
        # (camera, arrival - camera): the earliest arrival of each bin
        self._bins: deque[tuple[int, int]] = deque()
        self._newest: int | None = None  # camera's time, unwrapped
        self._late = 0  # frames in a row
        self.drift = 0.0
        self._origin = self._offset = 0

    def _was_set(self, device: int, arrival: int) -> bool:
        """Whether one of the clocks was: a frame came earlier than possible, or all come far too late."""
        behind = arrival - device - self._predict(device)
        self._late = self._late + 1 if behind > JUMP else 0
        return behind < -JUMP or device < self._newest or self._late > PATIENCE

    def _unwrap(self, device: int) -> int:
        if not self._wraps or self._newest is None:
            return device
        turns = round((self._newest - device) / self._wraps)
        return device + turns * self._wraps

    def _predict(self, device: int) -> int:
        return self._offset + round(self.drift * (device - self._origin))

    def _add(self, device: int, difference: int) -> None:
        bins = self._bins
        if bins and bins[-1][0] // BIN == device // BIN:
            if difference < bins[-1][1]:
                bins[-1] = device, difference
        else:
            bins.append((device, difference))
        while bins[0][0] < device - WINDOW:
            bins.popleft()
        self._fit()

    def _fit(self) -> None:
        """The edge of the lower hull that lies below the middle of the window."""
        first, last = self._bins[0][0], self._bins[-1][0]
        if last - first < SETTLED:
            self._origin, self._offset, self.drift = first, min(d for _, d in self._bins), 0.0
            return
        hull: list[tuple[int, int]] = []
        for x, y in self._bins:
            while len(hull) > 1 and _is_above(hull[-1], hull[-2], (x, y)):
                hull.pop()
            hull.append((x, y))
        middle = sum(x for x, _ in self._bins) / len(self._bins)
        (x0, y0), (x1, y1) = next((a, b) for a, b in zip(hull, hull[1:]) if a[0] <= middle <= b[0])
        self.drift = max(-MAX_DRIFT, min(MAX_DRIFT, (y1 - y0) / (x1 - x0)))
        # A drift that was cut down no longer follows the edge: the line still has to lie below every arrival.
        self._origin = x0
        self._offset = min(d - round(self.drift * (x - x0)) for x, d in self._bins)


def _is_above(point: tuple[int, int], left: tuple[int, int], right: tuple[int, int]) -> bool:
    """Whether a point lies on or above the line between two others."""
    return (point[1] - left[1]) * (right[0] - left[0]) >= (right[1] - left[1]) * (point[0] - left[0])
