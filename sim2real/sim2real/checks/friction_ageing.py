"""Whether the friction of a joint depends on how long the joint has been at rest.

A joint at rest does not show its friction, but the first moments of the motion after it do. The catalogue has no
friction that ages at rest (rising static friction: Armstrong-Helouvry et al., Automatica 1994). Where what is left at
reversals follows the time at rest, the catalogue has no explanation.
"""

from __future__ import annotations

import numpy as np

from sim2real.inference.fit import predict_held_out_residual
from sim2real.inference.search import ModelSearch, fits_by_joint
from sim2real.recordings.signals import GRID, Samples
from sim2real.thresholds import THRESHOLDS

STANDSTILL = THRESHOLDS.standstill


def find_friction_ageing(search: ModelSearch, members: tuple[int, ...]) -> set[int]:
    """Joints whose friction after a rest depends on how long it was, of what these members leave."""
    design, found = search.design, set()
    fits = fits_by_joint(search, members)
    for cell in design.cells:
        if not cell.at_reversal or not cell.rows.any():
            continue
        left = predict_held_out_residual(cell, *fits[cell.joint])
        after = rest_columns(design.context.samples, cell.joint)
        after, left = (v[cell.rows] for v in design.stages.question_columns(cell.stage, cell.rows, after, left))
        if (np.abs(after[:, 0]) > STANDSTILL.fresh).sum() < STANDSTILL.rows:
            continue
        plain, aged = (_remaining(after[:, :count], left) for count in (1, 2))
        limit = design.context.arm.torque_limit[cell.joint]
        if plain - aged > max(STANDSTILL.share * plain, len(left) * (STANDSTILL.torque * limit) ** 2):
            found.add(cell.joint)
    return found


def rest_columns(samples: Samples, joint: int) -> np.ndarray:
    """Columns (n, 2): the direction of a motion that has just begun, fading; and that times the logarithm of the time at
    rest before it."""
    fresh, aged = zip(*(_memory(velocity[:, joint]) for _, velocity in samples.segments))
    return np.column_stack([samples.filter(list(fresh)), samples.filter(list(aged))])


def _memory(velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two columns (m,) of `rest_columns`, from a velocity (m,) rad/s on the fine grid."""
    smooth = np.convolve(np.pad(velocity, 4, mode="edge"), np.full(9, 1 / 9), mode="valid")
    still = np.abs(smooth) <= STANDSTILL.still
    edges = np.concatenate([[0], np.flatnonzero(np.diff(still)) + 1, [len(still)]])
    for start, end in zip(edges[:-1], edges[1:]):
        if still[start] and (end - start) * GRID < STANDSTILL.shortest:
            still[start:end] = False
    row = np.arange(len(still))
    stood, moved = (np.maximum.accumulate(np.where(mask, row, -1)) for mask in (still, ~still))
    rest = (stood - moved[stood]) * GRID  # the length of the last rest
    fresh = np.where(still | (stood < 0), 0.0, np.exp(-(row - stood) * GRID / STANDSTILL.fade) * np.sign(smooth))
    return fresh, fresh * np.log1p(np.maximum(rest, 0.0) / STANDSTILL.long)


def _remaining(columns: np.ndarray, values: np.ndarray) -> float:
    """Sum of squares that a least-squares fit of columns (n, k) leaves of values (n,)."""
    factors = np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(np.square(values - columns @ factors).sum())
