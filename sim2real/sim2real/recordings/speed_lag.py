"""Reported speeds held against positions: a driver that filters them reports them late."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.recordings.reading import ContractViolation
from sim2real.recordings.signals import GRID, Log, sample_logs
from sim2real.thresholds import THRESHOLDS

RECORDINGS = THRESHOLDS.recordings


def estimate_speed_lag(log: Log) -> np.ndarray:
    """s (k,) by which the reported speed of each joint is later than the derivative of its position; NaN where the motion does not determine it.

    Least squares of v = g q' - g T q'' through the same filter: a lag T moves a slow signal by its derivative times T.
    """
    samples, found = sample_logs([log]), []
    for j in range(log.position.shape[1]):
        slopes = [np.gradient(position[:, j], GRID) for position, _ in samples.segments]
        speed = samples.filter(slopes)
        columns = np.column_stack([speed, samples.filter([np.gradient(slope, GRID) for slope in slopes])])
        gram = columns.T @ columns
        if np.ptp(speed) < THRESHOLDS.rows.standstill or np.linalg.cond(gram) > 1e12:
            found.append(np.nan)
            continue
        values = np.linalg.solve(gram, columns.T @ samples.velocity[:, j])
        left = samples.velocity[:, j] - columns @ values
        error = np.sqrt(np.linalg.inv(gram)[1, 1] * (left @ left) / len(left)) / abs(values[0])
        found.append(-values[1] / values[0] if error < RECORDINGS.speed_lag_error else np.nan)
    return np.array(found)


def correct_speed(log: Log, joints: Sequence[str]) -> Log:
    """The log, with the derivative of position in place of a speed that lags behind it (`Log.speed_lag`).

    Raises ContractViolation where speeds come before positions, or lag although a controller's law was computed with them.
    """
    lag = estimate_speed_lag(log)
    wrong = np.flatnonzero(np.abs(lag) > RECORDINGS.speed_lag)
    if not wrong.size:
        return log
    worst = wrong[np.argmax(np.abs(lag[wrong]))]
    side = "lags behind" if lag[worst] > 0 else "is ahead of"
    if lag[worst] < 0 or log.commands is not None:
        raise ContractViolation(
            f"{log.name}: expected speeds of the time of their positions, the speed of {joints[worst]} {side} its position by "
            f"{1e3 * abs(lag[worst]):.0f} ms: record it unfiltered"
        )
    return replace(log, velocity=np.gradient(log.position, log.time, axis=0), speed_lag=float(lag[worst]))
