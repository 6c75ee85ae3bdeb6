"""Bounded Bayesian least squares on the sums of several cells, and the score of what it predicts unseen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.effects.regressor import Parameter
from sim2real.inference.block_arrow import BlockArrowInverse, BlockArrowSolution, BlockArrowStructure, BlockArrowSystem
from sim2real.inference.residual_cells import ROUNDING, ResidualCell

PASSES = 3  # between parameters and noise, which determine each other
BOUND_PASSES = 2  # with parameters held at their bounds
SMALLEST_VARIANCE = 1e-16  # of a row, unit^2


@dataclass(frozen=True, eq=False)
class ParameterFit:
    """m fits of p parameters: parameters (m, p), covariance (m, p, p), variance (cells, m) of one row.

    `score_held_out` keeps no covariance, which of all joints together is ten megabytes a model.
    """

    parameters: np.ndarray
    covariance: np.ndarray | None
    variance: np.ndarray


@dataclass(frozen=True, eq=False)
class HeldOutScore:
    """Held-out result: log predictive density (m,) of each block, all cells; the fits."""

    density: np.ndarray
    fit: ParameterFit


def parameter_indices(cell: ResidualCell, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(columns of the cell, their places in ids) of those parameters that show in it."""
    columns = cell.column_of.take(ids, mode="clip")
    at = np.flatnonzero(columns >= 0)
    at = at[columns[at].argsort()]
    return columns[at], at


def sub_gram(gram: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Gram matrices (m, k + 1, k + 1) of the residual and some columns, in this order."""
    chosen = np.concatenate([[gram.shape[-1] - 1], columns])
    return gram[:, chosen[:, None], chosen]


def residual_sum_of_squares(gram: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Squared residual (..., m) after columns @ values (..., m, k); gram (..., m, k + 1, k + 1) of `sub_gram`."""
    factors = np.concatenate([np.ones((*values.shape[:-1], 1)), -values], axis=-1)
    left = (np.matmul(gram, factors[..., None])[..., 0] * factors).sum(axis=-1)
    return np.maximum(left, 0.0)


def fit_parameters(
    cells: Sequence[ResidualCell],
    grams: Sequence[np.ndarray],
    rows: Sequence[np.ndarray],
    ids: np.ndarray,
    parameters: Sequence[Parameter],
) -> ParameterFit:
    """Posterior mode within the bounds for each of the m sums; grams, rows: of each cell, (m, ...) and (m,)."""
    where = [parameter_indices(cell, ids) for cell in cells]
    needed = _padded([sub_gram(gram, columns) for gram, (columns, _) in zip(grams, where)])
    found = _fit(cells, [at for _, at in where], needed, np.array(rows), [parameters[i] for i in ids])
    return ParameterFit(found.parameters, found.inverse.dense(), found.variance)


@dataclass(frozen=True, eq=False)
class _Solved:
    """A fit whose covariance is not written out; local: of each cell's parameters, the places in its joint's part of it."""

    parameters: np.ndarray
    inverse: BlockArrowInverse
    local: list[np.ndarray]
    variance: np.ndarray


def _padded(parts: Sequence[np.ndarray]) -> np.ndarray:
    """(cells, m, k, k) of Gram matrices of different sizes, zeros where one is smaller and in the last row and column."""
    size = max(p.shape[-1] for p in parts) + 1
    whole = np.zeros((len(parts), len(parts[0]), size, size))
    for n, p in enumerate(parts):
        whole[n, :, : p.shape[-1], : p.shape[-1]] = p
    return whole


def _fit(
    cells: Sequence[ResidualCell],
    where: Sequence[np.ndarray],
    grams: np.ndarray,
    rows: np.ndarray,
    chosen: Sequence[Parameter],
) -> _Solved:
    """Of the cells' padded Gram matrices (cells, m, k, k), whose columns are the parameters `where`; rows (cells, m)."""
    count, size = rows.shape[1], len(chosen)
    prior, centre, lower, upper = (
        np.array([getattr(p, name) for p in chosen]) for name in ("prior", "centre", "lower", "upper")
    )
    # What is padded points at a parameter that is always zero.
    at = np.full((len(where), grams.shape[-1] - 1), size)
    for n, own in enumerate(where):
        at[n, : len(own)] = own
    rows = np.maximum(rows, 1.0)
    spare = np.maximum(rows - np.array([[len(own)] for own in where]), 1.0)
    floor = np.maximum(SMALLEST_VARIANCE, _rounding(grams, np.append(prior, 0.0)[at]))
    variance = np.maximum(grams[:, :, 0, 0] / rows, floor)
    shape = BlockArrowStructure.from_members([cell.joint for cell in cells], where, size)
    local = [shape.local_indices(cell.joint, own) for cell, own in zip(cells, where)]
    stacked = _stacked(shape, [cell.joint for cell in cells], local, grams)
    for number in range(PASSES):
        normal, moment = BlockArrowSystem.diagonal(shape, count, prior**-2), np.tile(centre * prior**-2, (count, 1))
        for joint, (mine, equations) in stacked.items():
            block, border = shape.blocks[joint], shape.border
            width = len(block) + len(border)
            sums = np.matmul(1 / variance[mine].T[:, None], equations).reshape(count, width + 1, width)
            normal.parts[joint] += sums[:, 1:]
            moment[:, block] += sums[:, 0, : len(block)]
            moment[:, border] += sums[:, 0, len(block) :]
        if number == PASSES - 1:
            inverse = normal.inverse()
            solution = inverse.multiply(moment)
        else:
            solution = normal.solve(moment)
        solved = solution.values
        outside = (solved < lower) | (solved > upper)
        if outside.any():
            solved = _bounded(normal, moment, solution, lower, upper, outside)
        values = np.concatenate([solved, np.zeros((count, 1))], axis=1)[:, at].transpose(1, 0, 2)
        variance = np.maximum(residual_sum_of_squares(grams, values) / spare, floor)
    return _Solved(solved, inverse, local, variance)


def _rounding(grams: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Variance (cells, m) below which double precision loses the priors beside the data.

    In units of its prior a parameter's equation is column' column prior^2 / variance + 1. A recording without noise has no
    variance of its own; two equal columns would then make the matrix singular. grams: (cells, m, k + 1, k + 1);
    prior: (cells, k), 0 where padded.
    """
    squares = np.diagonal(grams, axis1=2, axis2=3)[..., 1:] * prior[:, None] ** 2
    return ROUNDING * squares.max(axis=-1, initial=0.0)


def _stacked(
    shape: BlockArrowStructure, joints: Sequence[int], local: Sequence[np.ndarray], grams: np.ndarray
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Of each joint the numbers (c,) of its cells and, one below the other, their moments and normal equations
    (m, c, (k + 1) k) in the order of its block and the border: a pass over them is one product."""
    found = {}
    for joint, block in shape.blocks.items():
        mine = np.flatnonzero(np.array(joints) == joint)
        equations = []
        for n in mine:
            column = np.full(len(block) + len(shape.border), grams.shape[-1] - 1)  # that is zero
            column[local[n]] = 1 + np.arange(len(local[n]))
            rows = grams[n].take(np.concatenate([[0], column]), axis=1)
            equations.append(rows.take(column, axis=2).reshape(len(rows), -1))
        found[joint] = mine, np.stack(equations, axis=1)
    return found


def score_held_out(cells: Sequence[ResidualCell], ids: np.ndarray, parameters: Sequence[Parameter]) -> HeldOutScore:
    """Fit without each block and its surroundings, and predict the block."""
    where = [parameter_indices(cell, ids) for cell in cells]
    parts = [cell.parts(columns) for cell, (columns, _) in zip(cells, where)]
    train, test = (_padded([p[side] for p in parts]) for side in (0, 1))
    rows = np.array([cell.test_rows.sum() - cell.held_rows for cell in cells])
    fitted = _fit(cells, [at for _, at in where], train, rows, [parameters[i] for i in ids])
    covariance = {joint: fitted.inverse.block(joint) for joint in {cell.joint for cell in cells}}
    spread, squares = np.zeros(rows.shape), np.zeros(rows.shape)
    for n, (cell, (_, at), local) in enumerate(zip(cells, where, fitted.local)):
        own = test[n, :, : len(at) + 1, : len(at) + 1]
        squares[n] = residual_sum_of_squares(own, fitted.parameters[:, at])
        if len(at):
            spread[n] = (own[:, 1:, 1:] * covariance[cell.joint][:, local[:, None], local]).sum(axis=(1, 2))
    rows = np.maximum(np.array([cell.test_rows for cell in cells]), 1)
    variance = fitted.variance + spread / rows
    density = -0.5 * rows * (np.log(2 * np.pi * variance) + squares / rows / variance)
    return HeldOutScore(
        (density * np.array([cell.used for cell in cells])).sum(axis=0),
        ParameterFit(fitted.parameters, None, fitted.variance),
    )


def held_out_energy(cell: ResidualCell, ids: np.ndarray, fit: ParameterFit) -> float:
    """Sum of squares of `predict_held_out_residual` over the rows that count, from the cell's Gram matrices."""
    columns, at = parameter_indices(cell, ids)
    return float(residual_sum_of_squares(sub_gram(cell.plain, columns), fit.parameters[:, at]).sum() + cell.outside)


def predict_held_out_residual(cell: ResidualCell, ids: np.ndarray, fit: ParameterFit) -> np.ndarray:
    """Residual (n,) of a cell that a fit leaves of blocks it has not seen; the residual itself outside of blocks."""
    columns, at = parameter_indices(cell, ids)
    values = np.where((cell.block >= 0)[:, None], fit.parameters[np.maximum(cell.block, 0)][:, at], 0.0)
    return cell.residual - sum((cell.matrix[:, k] * values[:, n] for n, k in enumerate(columns)), 0.0)


def _bounded(normal: BlockArrowSystem, moment, solution: BlockArrowSolution, lower, upper, outside) -> np.ndarray:
    """Least squares in a box: what leaves it is held at its side, and the rest is solved again, twice."""
    rows = np.flatnonzero(outside.any(axis=1))
    outside, inside = outside[rows], solution.values[rows]
    held, diagonal = np.zeros_like(outside), normal.diagonals(rows)
    for _ in range(BOUND_PASSES):
        held |= outside
        side = np.clip(inside, lower, upper)
        stiff = np.where(held, 1e9 * diagonal, 0.0)
        inside = normal.solve_again(solution, moment[rows] + stiff * side, rows, stiff).values
        outside = ((inside < lower) | (inside > upper)) & ~held
        if not outside.any():
            break
    found = solution.values.copy()
    found[rows] = np.clip(inside, lower, upper)
    return found
