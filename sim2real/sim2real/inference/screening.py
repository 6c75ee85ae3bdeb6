"""The expected gain of each candidate before any model with it is scored: the search tries only the best."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sim2real.inference.fit import ParameterFit
from sim2real.inference.regression import RegressionProblem

EDGE = 1e-3  # of the range from its bound within which a parameter absorbs no more


def likelihood_gains(
    design: RegressionProblem, groups: Iterable[tuple[tuple[int, ...], np.ndarray, ParameterFit]]
) -> np.ndarray:
    """Rise of the likelihood (candidates,), nats, to second order, by each candidate's addition to a model.

    groups: of that model, the joints, the ids of their parameters, and the fit of these.
    """
    size = len(design.parameters)
    normal, slope = np.zeros((size, size)), np.zeros(size)
    inside = np.zeros(size, bool)
    values = np.zeros(size)
    variance = {}
    for joints, ids, fit in groups:
        inside[ids] = True
        values[ids] = fit.parameters.mean(axis=0)
        cells = [cell for j in joints for cell in design.cells_of(j)]
        variance |= {id(c): v.mean() for c, v in zip(cells, fit.variance)}
    for cell, gram in zip(design.cells, (cell.total for cell in design.cells)):
        v = variance[id(cell)]
        normal[np.ix_(cell.ids, cell.ids)] += gram[:-1, :-1] / v
        slope[cell.ids] += (gram[:-1, -1] - gram[:-1, :-1] @ values[cell.ids]) / v
    prior, centre, lower, upper = (
        np.array([getattr(p, name) for p in design.parameters]) for name in ("prior", "centre", "lower", "upper")
    )
    normal[np.diag_indices(size)] += prior**-2
    # What the parameters in use can take up themselves is not gained; one at its bound takes up nothing beyond it.
    edge = EDGE * (upper - lower)
    pull = slope - (values - centre) / prior**2
    stuck = ((values > upper - edge) & (pull > 0)) | ((values < lower + edge) & (pull < 0))
    used = np.flatnonzero(inside & ~stuck)
    taken = np.linalg.solve(normal[np.ix_(used, used)], normal[used])
    gradient, coupled, diagonal = slope - taken.T @ slope[used], normal[used].T, np.diag(normal)
    sizes, found = np.array([len(c.ids) for c in design.candidates]), np.empty(len(design.candidates))
    for width in set(sizes.tolist()):  # all candidates of as many parameters at once
        alike = np.flatnonzero(sizes == width)
        i = np.array([design.candidates[n].ids for n in alike])
        left = normal[i[:, :, None], i[:, None]] - np.matmul(coupled[i], taken.T[i].transpose(0, 2, 1))
        left += 1e-9 * diagonal[i][:, :, None] * np.eye(width)
        pulled = gradient[i] + centre[i] / prior[i] ** 2
        found[alike] = 0.5 * (gradient[i] * np.linalg.solve(left, pulled[..., None])[..., 0]).sum(axis=-1)
    return found
