"""What changed between two recordings of the same arm: what both of them have in common is taken out beforehand.

The nominal model need not be right. Whatever an effect, a nuisance or the flexible model of the omnibus test could say of
both recordings alike is projected out of the residual of the later one and of the columns by which its effects show there
(Frisch and Waugh 1933); what is left of a residual is the change, and the effects compete for it as they do for a gap.
"""

from __future__ import annotations

import numpy as np

KNOWN = 1e-9  # of the strongest direction of the common columns, below which one is rounding


def directions(common: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """What columns (n, s) that recordings have in common span, as columns (n, k) that are orthonormal over `rows` (n,) bool."""
    used = common[rows]
    scale = np.sqrt(np.mean(np.square(used), axis=0)) if len(used) else np.zeros(common.shape[1])
    shown = scale > 0
    if not shown.any():
        return np.zeros((len(common), 0))
    common, used = common[:, shown] / scale[shown], used[:, shown] / scale[shown]
    power, axes = np.linalg.eigh(used.T @ used)
    kept = power > KNOWN * power[-1]
    return common @ (axes[:, kept] / np.sqrt(power[kept]))


def apart(spanned: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n, c) without what a fit to their `rows` (n,) bool puts into `directions` (n, k) of the same rows."""
    return values - spanned @ (spanned.T @ (values * rows[:, None]))
