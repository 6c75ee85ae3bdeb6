"""Bounded Bayesian least squares on the sums of several cells, and the score of what it predicts unseen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from np_diagnosis.design import Cell, Parameter

PASSES = 3  # noise and parameters determine each other; three rounds settle
LEAST_VARIANCE = 1e-16


@dataclass(frozen=True, eq=False)
class Fit:
    """m fits of p parameters: parameters (m, p), covariance (m, p, p), variance (cells, m) of one row."""

    parameters: np.ndarray
    covariance: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True, eq=False)
class Score:
    """Held-out result: log predictive density (m,) of each block, all cells; the fits."""

    density: np.ndarray
    fit: Fit


def places(cell: Cell, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(columns of the cell, their places in ids) of those parameters that show in it."""
    order = {int(i): n for n, i in enumerate(ids)}
    shared = [(k, order[int(i)]) for k, i in enumerate(cell.ids) if int(i) in order]
    if not shared:
        return np.zeros(0, int), np.zeros(0, int)
    columns, at = zip(*shared)
    return np.array(columns), np.array(at)


def fit(
    cells: Sequence[Cell],
    grams: Sequence[np.ndarray],
    rows: Sequence[np.ndarray],
    ids: np.ndarray,
    parameters: Sequence[Parameter],
) -> Fit:
    """Posterior mode within the bounds for each of the m sums; grams, rows: of each cell, (m, ...) and (m,)."""
    where = [places(cell, ids) for cell in cells]
    count = len(rows[0]) if rows else 0
    prior = np.array([parameters[i].prior for i in ids])
    centre = np.array([parameters[i].centre for i in ids])
    lower = np.array([parameters[i].lower for i in ids])
    upper = np.array([parameters[i].upper for i in ids])
    squares = [np.maximum(g[:, -1, -1], 0.0) for g in grams]
    counts = [np.maximum(r, 1.0) for r in rows]
    variance = [np.maximum(s / n, LEAST_VARIANCE) for s, n in zip(squares, counts)]
    precision = np.tile(np.diag(prior**-2), (count, 1, 1))
    for _ in range(PASSES):
        normal, moment = precision.copy(), np.tile(centre * prior**-2, (count, 1))
        for (columns, at), gram, v in zip(where, grams, variance):
            if columns.size:
                normal[:, at[:, None], at] += gram[:, columns[:, None], columns] / v[:, None, None]
                moment[:, at] += gram[:, columns, -1] / v[:, None]
        solved = np.linalg.solve(normal, moment[..., None])[..., 0]
        outside = (solved < lower) | (solved > upper)
        if outside.any():
            solved = _bounded(normal, moment, solved, lower, upper, outside)
        for n, ((columns, at), gram) in enumerate(zip(where, grams)):
            left = remaining(gram, columns, solved[:, at])
            variance[n] = np.maximum(left / np.maximum(counts[n] - columns.size, 1), LEAST_VARIANCE)
    return Fit(solved, np.linalg.inv(normal), np.array(variance))


def remaining(gram: np.ndarray, columns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Squared residual (m,) after columns @ values (m, k)."""
    part = gram[:, columns[:, None], columns]
    left = (
        gram[:, -1, -1]
        - 2 * np.einsum("bi,bi->b", values, gram[:, columns, -1])
        + np.einsum("bi,bij,bj->b", values, part, values)
    )
    return np.maximum(left, 0.0)


def score(cells: Sequence[Cell], ids: np.ndarray, parameters: Sequence[Parameter]) -> Score:
    """Fit without each block and its surroundings, and predict the block."""
    trains = [cell.train for cell in cells]
    counts = [cell.test_rows.sum() - cell.held_rows for cell in cells]
    fitted = fit(cells, trains, counts, ids, parameters)
    density = np.zeros(len(fitted.parameters))
    for n, cell in enumerate(cells):
        columns, at = places(cell, ids)
        squares = remaining(cell.test, columns, fitted.parameters[:, at])
        rows = np.maximum(cell.test_rows, 1)
        part = cell.test[:, columns[:, None], columns]
        spread = np.einsum("bij,bji->b", part, fitted.covariance[:, at[:, None], at]) / rows
        variance = fitted.variance[n] + spread
        own = -0.5 * rows * (np.log(2 * np.pi * variance) + squares / rows / variance)
        density += np.where(cell.used, own, 0.0)
    return Score(density, fitted)


def _bounded(normal, moment, solved, lower, upper, outside) -> np.ndarray:
    """Least squares in a box: what leaves it is held at its side, and the rest is solved again, twice."""
    held = np.zeros_like(outside)
    for _ in range(2):
        held |= outside
        side = np.clip(solved, lower, upper)
        stiff = np.where(held, 1e9 * np.einsum("bii->bi", normal), 0.0)
        stiffened = normal + stiff[:, :, None] * np.eye(normal.shape[1])
        solved = np.linalg.solve(stiffened, (moment + stiff * side)[..., None])[..., 0]
        outside = ((solved < lower) | (solved > upper)) & ~held
        if not outside.any():
            break
    return np.clip(solved, lower, upper)
