"""Bounded Bayesian least squares on sums, and the score of what it predicts for blocks it has not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_diagnosis.design import Design, Sums

PASSES = 3  # noise and parameters determine each other; three rounds settle


@dataclass(frozen=True, eq=False)
class Fit:
    """m fits: parameters (m, k), covariance (m, k, k), noise variance (m,) of one sample."""

    parameters: np.ndarray
    covariance: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True, eq=False)
class Score:
    """Held-out result a block: log predictive density (m,), squared error summed (m,), and the fits.

    used (m,): blocks that say something; the rest has zeros.
    """

    density: np.ndarray
    squares: np.ndarray
    fit: Fit
    used: np.ndarray


def fit(sums: Sums, columns: np.ndarray, design: Design) -> Fit:
    """Posterior mode within the bounds, for each of the m sums.

    Prior N(0, prior^2); `correlation` samples count as one, so that neither prior nor covariance believes
    that
    neighbouring samples are independent.
    """
    normal = sums.gram[:, columns[:, None], columns]
    moment, square = sums.gram[:, columns, -1], sums.gram[:, -1, -1]
    precision = np.diag(design.prior[columns] ** -2)
    lower, upper = design.lower[columns], design.upper[columns]
    rows = np.maximum(sums.rows, 1)
    variance = np.maximum(square / rows, 1e-12)
    for _ in range(PASSES):
        regular = normal + (variance * design.correlation)[:, None, None] * precision
        parameters = np.linalg.solve(regular, moment[..., None])[..., 0]
        for i in np.flatnonzero(((parameters < lower) | (parameters > upper)).any(axis=1)):
            parameters[i] = _bounded(regular[i], moment[i], lower, upper)
        squares = (
            square
            - 2 * np.einsum("bi,bi->b", parameters, moment)
            + np.einsum("bi,bij,bj->b", parameters, normal, parameters)
        )
        variance = np.maximum(squares / np.maximum(rows - len(columns), 1), 1e-12)
    covariance = (variance * design.correlation)[:, None, None] * np.linalg.inv(regular)
    return Fit(parameters, covariance, variance)


def score(train: Sums, test: Sums, columns: np.ndarray, design: Design) -> Score:
    """Fit to each of the training sums, and predict the block it has not seen."""
    fitted = fit(train, columns, design)
    normal = test.gram[:, columns[:, None], columns]
    squares = (
        test.gram[:, -1, -1]
        - 2 * np.einsum("bi,bi->b", fitted.parameters, test.gram[:, columns, -1])
        + np.einsum("bi,bij,bj->b", fitted.parameters, normal, fitted.parameters)
    )
    squares = np.maximum(squares, 0.0)
    rows = np.maximum(test.rows, 1)
    variance = fitted.variance + np.einsum("bij,bji->b", normal, fitted.covariance) / rows
    density = -0.5 * rows / design.correlation * (np.log(2 * np.pi * variance) + squares / rows / variance)
    used = design.used
    return Score(np.where(used, density, 0.0), np.where(used, squares, 0.0), fitted, used)


def _bounded(normal: np.ndarray, moment: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Least squares in a box: what leaves it is put on its side, and the rest is solved again."""
    x, free = np.zeros(len(moment)), np.ones(len(moment), bool)
    while free.any():
        x[free] = np.linalg.solve(
            normal[np.ix_(free, free)], moment[free] - normal[np.ix_(free, ~free)] @ x[~free]
        )
        outside = (x < lower) | (x > upper)
        if not outside.any():
            break
        x, free = np.clip(x, lower, upper), free & ~outside
    return x
