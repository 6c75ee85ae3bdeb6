"""The share of its limits that an arm uses: a motion with a small share does not trip the reflex of the next robot."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from np_description.panda import NOMINAL, PandaModel

LIMIT_NAMES = ("velocity", "torque", "range")


def limit_shares(
    position: np.ndarray, velocity: np.ndarray, torque: np.ndarray, panda: PandaModel = NOMINAL
) -> np.ndarray:
    """Shares (3, ..., 7) of the limits `LIMIT_NAMES`, 1 at the limit: of speed and torque their size, of the range how far from
    its middle. position rad, velocity rad/s, torque Nm: (..., 7)."""
    middle, half = (panda.position_upper + panda.position_lower) / 2, (panda.position_upper - panda.position_lower) / 2
    return np.stack(
        [
            np.abs(velocity) / panda.velocity_limit,
            np.abs(torque) / panda.torque_limit,
            np.abs(position - middle) / half,
        ]
    )


def summary(shares: Iterable[np.ndarray]) -> dict[str, dict[str, float | list[float]]]:
    """Quantiles of the episodes' largest shares (3, 7), by limit: median and 99 % of any joint, and 99 % of each joint.

    {} for no episodes.
    """
    largest = np.array(list(shares))
    if not len(largest):
        return {}
    return {
        name: {
            "median": round(float(np.median(column.max(-1))), 3),
            "q99": round(float(np.quantile(column.max(-1), 0.99)), 3),
            "by_joint_q99": np.quantile(column, 0.99, axis=0).round(3).tolist(),
        }
        for name, column in zip(LIMIT_NAMES, largest.transpose(1, 0, 2))
    }
