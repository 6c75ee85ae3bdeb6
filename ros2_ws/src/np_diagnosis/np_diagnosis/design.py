"""Blocks of samples, and for each joint the sums over blocks that every least-squares question needs.

All candidate structures of a joint are choices of columns from one matrix. Its Gram matrices, one a block,
hold everything: a fit to any blocks, and its error on any other, is a few operations on small matrices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from np_diagnosis.effects import Effect, arm_effects, joint_effects, nuisances
from np_diagnosis.nominal import STANDSTILL, Prediction
from np_diagnosis.signals import DECIMATION, GRID, Samples

BLOCKS = 10  # at least
BLOCK_DURATION = 3.0  # s, where there are more
LEAST_ROWS = 20  # of motion in a block, below which it says nothing about a joint
GAP = 0.5  # s left out of training on either side of the block that is predicted
NUISANCES = 2


@dataclass(frozen=True, eq=False)
class Block:
    """Rows that are predicted together, and the rows (these and their surroundings) kept out of that fit."""

    rows: np.ndarray
    excluded: np.ndarray


def make_blocks(samples: Samples, gap: float = GAP) -> list[Block]:
    """Contiguous stretches of one trajectory each, of about equal length.

    Short trajectories are blocks of their own. Raises ValueError where a block would not be three gaps long.
    """
    trajectories = [np.flatnonzero(samples.trajectory == k) for k in np.unique(samples.trajectory)]
    pieces = [1] * len(trajectories)
    count = max(BLOCKS, int(len(samples) * GRID * DECIMATION / BLOCK_DURATION))
    while sum(pieces) < count:
        pieces[int(np.argmax([len(rows) / n for rows, n in zip(trajectories, pieces)]))] += 1
    margin = round(gap / (GRID * DECIMATION))
    blocks = []
    for rows, n in zip(trajectories, pieces):
        for part in np.array_split(np.arange(len(rows)), n):
            if part.size < 3 * margin:
                raise ValueError(
                    f"expected blocks of at least {3 * gap} s, {count} in all; got "
                    f"{part.size * GRID * DECIMATION:.2f} s: record more"
                )
            blocks.append(Block(rows[part], rows[max(0, part[0] - margin) : part[-1] + 1 + margin]))
    return blocks


@dataclass(frozen=True, eq=False)
class Sums:
    """Gram matrices (m, K + 1, K + 1) of columns and residual, over `rows` (m,) rows each."""

    gram: np.ndarray
    rows: np.ndarray

    def shifted(self, columns: np.ndarray, parameters: np.ndarray) -> Sums:
        """The sums of what is left of the residual after columns @ parameters (m, len(columns))."""
        change = np.zeros((len(self.gram), self.gram.shape[1]))
        change[:, columns] = parameters
        gram = self.gram.copy()
        side = gram[:, :, -1] - np.einsum("bij,bj->bi", gram, change)
        gram[:, :, -1], gram[:, -1, :] = side, side
        gram[:, -1, -1] = (
            self.gram[:, -1, -1]
            - 2 * np.einsum("bi,bi->b", self.gram[:, :, -1], change)
            + np.einsum("bi,bij,bj->b", change, self.gram, change)
        )
        return Sums(gram, self.rows)


@dataclass(frozen=True, eq=False)
class Design:
    """One joint's columns and sums.

    columns: effect key -> indices; prior, lower, upper (K,), nuisances first; test and train: sums over each
    block, and over everything but the block and its surroundings; correlation: samples that count as one.
    Only rows in which the joint moves count (`moving` (n,)): a joint that stands is held by friction of any
    size up to its level, and its torque says nothing. torque_limit: Nm.
    """

    joint: int
    effects: dict[str, Effect]
    columns: dict[str, np.ndarray]
    matrix: np.ndarray
    residual: np.ndarray
    prior: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    test: Sums
    train: Sums
    correlation: float
    moving: np.ndarray
    torque_limit: float

    @property
    def used(self) -> np.ndarray:
        """Blocks (m,) in which the joint moves enough to be predicted."""
        return self.test.rows >= LEAST_ROWS


def make_design(
    samples: Samples, prediction: Prediction, joint: int, blocks: list[Block], torque_limit: float
) -> Design:
    """Columns of every effect for one joint, and their sums."""
    nuisance, prior = nuisances(samples, prediction, joint)
    matrix, priors = [nuisance], [prior]
    lower, upper = [np.full(NUISANCES, -np.inf)], [np.full(NUISANCES, np.inf)]
    effects, columns, width = {}, {}, NUISANCES
    for effect in joint_effects() + arm_effects():
        matrix.append(effect.columns(samples, prediction, joint))
        columns[effect.key] = np.arange(width, width + len(effect.parameters))
        effects[effect.key] = effect
        width += len(effect.parameters)
        priors.append(np.array([p.prior for p in effect.parameters]))
        lower.append(np.array([p.lower for p in effect.parameters]))
        upper.append(np.array([p.upper for p in effect.parameters]))
    table = np.column_stack(matrix)
    residual = samples.torque[:, joint] - prediction.total[:, joint]
    moving = np.abs(samples.velocity[:, joint]) > STANDSTILL
    whole = np.column_stack([table, residual]) * moving[:, None]
    gram = np.array([whole[b.rows].T @ whole[b.rows] for b in blocks])
    held = np.array([whole[b.excluded].T @ whole[b.excluded] for b in blocks])
    count, left_out = (
        np.array([moving[rows].sum() for rows in side])
        for side in ([b.rows for b in blocks], [b.excluded for b in blocks])
    )
    total = whole.T @ whole
    scale = np.concatenate(priors)
    return Design(
        joint,
        effects,
        columns,
        table,
        residual,
        scale,
        np.concatenate(lower),
        np.concatenate(upper),
        Sums(gram, count),
        Sums(total - held, moving.sum() - left_out),
        _correlation(table[moving], residual[moving], scale),
        moving,
        torque_limit,
    )


def _correlation(matrix: np.ndarray, residual: np.ndarray, prior: np.ndarray) -> float:
    """Integrated autocorrelation time, in samples, of what all columns together leave."""
    scaled = matrix * prior
    left = residual - scaled @ np.linalg.solve(
        scaled.T @ scaled + 0.05**2 * np.eye(scaled.shape[1]), scaled.T @ residual
    )
    if len(left) < LEAST_ROWS:
        return 1.0
    left = left - left.mean()
    size = 1 << int(np.ceil(np.log2(2 * len(left))))
    spectrum = np.fft.rfft(left, size)
    correlation = np.fft.irfft(spectrum * spectrum.conj(), size)[: len(left) // 4]
    if correlation[0] <= 0:
        return 1.0
    correlation = correlation / correlation[0]
    first = np.flatnonzero(correlation <= 0.05)
    return float(1 + 2 * correlation[1 : first[0] if first.size else None].sum())
