"""Corners of the object at the moments that an image is of, from poses that come once an image."""

from __future__ import annotations

from collections import deque

import numpy as np

from np_description.control_rate import SECOND
from np_description.domains import Pose
from np_description.keypoints import box_keypoints

FASTEST = 5.0  # m/s that an object is moved by; what goes farther has been put somewhere else


class OccludedKeypointBuffer:
    """The latest poses of a box of `half_size` (3,) m, of as long as `oldest` s ago and one before that."""

    def __init__(self, half_size: np.ndarray, oldest: float):
        self._half_size, self._oldest = half_size, oldest
        self._poses: deque[tuple[float, Pose]] = deque()

    def keep(self, stamp: int, pose: Pose) -> None:
        """The pose at `stamp` ns. An earlier stamp than the last, or a leap, begins anew."""
        now = stamp / SECOND
        if self._poses:
            last, before = self._poses[-1]
            if now == last:
                return
            if now < last or np.linalg.norm(pose.position - before.position) > FASTEST * (now - last):
                self._poses.clear()
        self._poses.append((now, pose))
        while len(self._poses) > 2 and self._poses[1][0] <= now - self._oldest:
            self._poses.popleft()

    def at(self, times: np.ndarray) -> np.ndarray:
        """Corners (n, 8, 3) m at times (n,) s: between two poses in proportion, the first of them before, the last after."""
        known = np.array([when for when, _ in self._poses])
        corners = np.array([box_keypoints(self._half_size, p.position, p.quaternion) for _, p in self._poses])
        if len(known) == 1:
            return np.repeat(corners, len(times), axis=0)
        k = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
        share = np.clip((times - known[k]) / (known[k + 1] - known[k]), 0.0, 1.0)[:, None, None]
        return (1 - share) * corners[k] + share * corners[k + 1]
