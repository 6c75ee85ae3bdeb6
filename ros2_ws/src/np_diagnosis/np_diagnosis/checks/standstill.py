"""What a joint that stood remembers: whether its friction depends on how long it had stood.

A joint at rest says nothing of its friction, but the first moments of the motion after it do. The catalogue has no
friction that ages at rest (rising static friction: Armstrong-Helouvry et al., Automatica 1994); where what is left at
reversals follows the time at rest, it has no explanation.
"""

from __future__ import annotations

import numpy as np

from np_diagnosis.inference.search import Search, fits_of, held_out
from np_diagnosis.recordings.signals import GRID, Samples

STILL = 0.005  # rad/s
LEAST_REST = 0.06  # s: shorter, and it is a turn, or noise
FADE = 0.08  # s for which a rest is remembered
REST = 0.5  # s from which on a rest is long
SHARE = 0.2  # of what is left at reversals, which the time at rest explains (a clean arm: under .01)
MATERIAL = 0.00025  # of the torque limit
LEAST_ROWS = 10  # shortly after a rest


def ageing(search: Search, members: tuple[int, ...]) -> set[int]:
    """Joints whose friction after a rest depends on how long it was, whatever the structure's effects say."""
    design, found = search.design, set()
    fits = fits_of(search, members)
    for cell in design.cells:
        if not cell.at_reversal or not cell.rows.any():
            continue
        left = held_out(cell, *fits[cell.joint])[cell.rows]
        after = after_rest(design.context.samples, cell.joint)[cell.rows]
        if (np.abs(after[:, 0]) > 0.3).sum() < LEAST_ROWS:
            continue
        plain, aged = (_remaining(after[:, :count], left) for count in (1, 2))
        limit = design.context.arm.torque_limit[cell.joint]
        if plain - aged > max(SHARE * plain, len(left) * (MATERIAL * limit) ** 2):
            found.add(cell.joint)
    return found


def after_rest(samples: Samples, joint: int) -> np.ndarray:
    """Columns (n, 2): direction of a motion that has just begun, fading; and times the logarithm of the rest before."""
    fresh, aged = zip(*(_memory(velocity[:, joint]) for _, velocity in samples.segments))
    return np.column_stack([samples.filter(list(fresh)), samples.filter(list(aged))])


def _memory(velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two columns (m,) on the fine grid."""
    smooth = np.convolve(np.pad(velocity, 4, mode="edge"), np.full(9, 1 / 9), mode="valid")
    still = np.abs(smooth) <= STILL
    edges = np.concatenate([[0], np.flatnonzero(np.diff(still)) + 1, [len(still)]])
    for start, end in zip(edges[:-1], edges[1:]):
        if still[start] and (end - start) * GRID < LEAST_REST:
            still[start:end] = False
    row = np.arange(len(still))
    stood, moved = (np.maximum.accumulate(np.where(mask, row, -1)) for mask in (still, ~still))
    rest = (stood - moved[stood]) * GRID  # the length of the last rest
    fresh = np.where(still | (stood < 0), 0.0, np.exp(-(row - stood) * GRID / FADE) * np.sign(smooth))
    return fresh, fresh * np.log1p(np.maximum(rest, 0.0) / REST)


def _remaining(columns: np.ndarray, values: np.ndarray) -> float:
    """Squares of values (n,) that columns (n, k) leave."""
    factors = np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(np.square(values - columns @ factors).sum())
