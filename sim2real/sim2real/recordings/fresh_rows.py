"""Rows that repeat the one before them: a driver that publishes faster than it reads its arm."""

from __future__ import annotations

import numpy as np

from sim2real.thresholds import THRESHOLDS


def find_fresh_rows(position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Which rows (n,) bool of positions and velocities (n, k) are no repetition of the row before.

    A row repeats the one before where both are equal to the last bit at every joint, although a joint moves.
    """
    moves = (np.abs(velocity[1:]) > THRESHOLDS.rows.standstill).any(axis=1)
    same = (np.diff(position, axis=0) == 0).all(axis=1) & (np.diff(velocity, axis=0) == 0).all(axis=1)
    return np.r_[True, ~(same & moves)]
