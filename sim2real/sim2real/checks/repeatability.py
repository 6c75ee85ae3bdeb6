"""How well the data repeat: what no model of the motion could explain."""

from __future__ import annotations

import numpy as np

from sim2real.recordings.signals import Samples
from sim2real.thresholds import THRESHOLDS

FLOOR = THRESHOLDS.floor

CHUNK = 500


def measure_repeatability(samples: Samples, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Floor of the residual (n, k) Nm by joint: (RMSE (k,) Nm, whether it was measured (k,) bool).

    It is measured where the arm came through the same state at least `FLOOR.pairs` times, a second or a trajectory
    apart: half the mean square of the difference. Elsewhere only the white noise of the sensor is known, which is a
    lower bound.
    """
    state = np.hstack(
        [
            samples.position / FLOOR.near_position,
            samples.velocity / FLOOR.near_velocity,
            samples.acceleration / FLOOR.near_acceleration,
        ]
    )
    state = state.astype(np.float32)
    square = (state**2).sum(axis=1)
    differences = []
    for start in range(0, len(samples), CHUNK):
        rows = np.arange(start, min(start + CHUNK, len(samples)))
        distance = square[rows, None] + square - 2 * state[rows] @ state.T
        near_in_time = (np.abs(samples.time[rows, None] - samples.time) < FLOOR.distance) & (
            samples.trajectory[rows, None] == samples.trajectory
        )
        distance[near_in_time] = np.inf
        nearest = distance.argmin(axis=1)
        same = np.abs(state[rows] - state[nearest]).max(axis=1) < 1
        moving = np.abs(samples.velocity[rows]).max(axis=1) > FLOOR.near_velocity
        differences.append(np.where((same & moving)[:, None], residual[rows] - residual[nearest], np.nan))
    difference = np.concatenate(differences)
    # A joint at rest does not show how well its motion repeats.
    difference[np.abs(samples.velocity) < FLOOR.near_velocity] = np.nan
    is_measured = np.isfinite(difference).sum(axis=0) >= FLOOR.pairs
    floor = samples.noise.copy()
    for joint in np.flatnonzero(is_measured):
        floor[joint] = max(floor[joint], np.sqrt(np.nanmean(difference[:, joint] ** 2) / 2))
    return floor, is_measured
