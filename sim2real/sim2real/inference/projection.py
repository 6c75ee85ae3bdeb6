"""What changed between two recordings of the same arm: what both of them have in common is taken out beforehand.

The nominal model need not be right. Whatever an effect, a nuisance or the flexible model of the omnibus test could explain in
both recordings alike is projected out of the residual of the later one and of the columns by which its effects show there
(Frisch and Waugh 1933); what is left of a residual is the change, and the effects compete for it as they do for a gap.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

KNOWN = 1e-9  # of the strongest direction of the common columns, below which one is rounding


def hstack_contiguous(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Columns (n, c) of several parts (n, any) one beside the other, each column contiguous: they are used one by one, and
    recordings are long."""
    side = np.empty((sum(part.shape[1] for part in parts), len(parts[0])))
    np.concatenate([part.T for part in parts], out=side)
    return side.T


def orthonormal_basis(common: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """What columns (n, s) that recordings have in common span, as columns (n, k) that are orthonormal over `rows` (n,) bool."""
    used = common if rows.all() else common.T[:, rows].T
    gram = used.T @ used
    scale = np.sqrt(np.diag(gram))
    shown = np.flatnonzero(scale > 0)
    if not shown.size:
        return np.zeros((len(common), 0))
    power, axes = np.linalg.eigh(gram[np.ix_(shown, shown)] / np.outer(scale[shown], scale[shown]))
    kept = power > KNOWN * power[-1]
    mixed = np.zeros((len(scale), kept.sum()))
    mixed[shown] = axes[:, kept] / np.sqrt(power[kept]) / scale[shown, None]
    return (mixed.T @ common.T).T  # each contiguous, as columns are


def project_out(spanned: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n, c) without what a fit to their `rows` (n,) bool puts into `orthonormal_basis` (n, k) of the same rows."""
    counted = values if rows.all() else values * rows[:, None]
    known = (counted.T @ spanned) @ spanned.T
    return np.subtract(values.T, known, out=known).T
