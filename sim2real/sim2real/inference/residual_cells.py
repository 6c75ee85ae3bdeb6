"""Cells: the sums of squares and products that a least-squares question about one stage of one joint needs.

Residuals and columns are prewhitened by the autoregression of what all columns together leave (Cochrane and Orcutt
1949), so that neighbouring rows count for no more than their information. A cell holds the Gram matrices of each block, and of
each block with its surroundings: any fit to all other blocks, and its error on this one, takes a few small matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim2real.effects.evidence import Context
from sim2real.effects.regressor import Parameter
from sim2real.effects.stage import Stage
from sim2real.inference.residual_stages import ResidualStages
from sim2real.thresholds import THRESHOLDS

VALIDATION = THRESHOLDS.blocks
ROUNDING = 1e-13  # smallest variance, relative to all that a column explains at its prior


@dataclass(frozen=True)
class TimeBlock:
    """Rows from start to end (s) of one trajectory, predicted together from what is a gap away."""

    trajectory: int
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class ResidualCell:
    """One stage of one joint; at_reversal: of its rows about reversals (`Stages.rows`).

    ids (p,): parameters with columns here, those of nuisances first. test, held (m, p + 1, p + 1): Gram matrices of
    columns and residual, of each block and of what its fit must not see; test_rows, held_rows (m,): their rows. plain
    (m, p + 1, p + 1): of each block before whitening; outside: squared residual of rows in no block. Before
    whitening: matrix (n, p), residual (n,), rows (n,) bool that count, and block (n,) that each is in (-1: none).
    whiten: coefficients of the autoregression.
    """

    stage: Stage
    joint: int
    ids: np.ndarray
    test: np.ndarray
    held: np.ndarray
    test_rows: np.ndarray
    held_rows: np.ndarray
    plain: np.ndarray
    outside: float
    matrix: np.ndarray
    residual: np.ndarray
    rows: np.ndarray
    block: np.ndarray
    whiten: np.ndarray
    at_reversal: bool = False

    @property
    def name(self) -> str:
        """Its residual's name in reports: "r2" or "r2 at reversal"."""
        return f"{self.stage} at reversal" if self.at_reversal else str(self.stage)

    @cached_property
    def column_of(self) -> np.ndarray:
        """The column of each parameter by its number, -1 without one; the last stands for all that follow."""
        columns = np.full(self.ids.max(initial=-1) + 2, -1)
        columns[self.ids] = np.arange(len(self.ids))
        return columns

    @cached_property
    def total(self) -> np.ndarray:
        """Gram matrix (p + 1, p + 1) of all blocks."""
        return self.test.sum(axis=0)

    @cached_property
    def unwhitened(self) -> np.ndarray:
        """Gram matrix (p + 1, p + 1) of all blocks before whitening."""
        return self.plain.sum(axis=0)

    @cached_property
    def train(self) -> np.ndarray:
        """Gram matrices (m, p + 1, p + 1) of all that the fit for each block may see."""
        return self.total - self.held

    def parts(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`train` and `test` of some columns and the residual, residual first; kept, for many models of a
        search share them."""
        key = columns.tobytes()
        if key not in self._parts:
            chosen = np.concatenate([[len(self.ids)], columns])
            held, test = (gram[:, chosen[:, None], chosen] for gram in (self.held, self.test))
            self._parts[key] = test.sum(axis=0) - held, test
        return self._parts[key]

    @cached_property
    def _parts(self) -> dict:
        return {}

    @property
    def used(self) -> np.ndarray:
        """Blocks (m,) with enough rows to be predicted."""
        return self.test_rows >= VALIDATION.rows


def make_blocks(context: Context) -> tuple[TimeBlock, ...]:
    """Contiguous stretches of one trajectory each, of about equal length.

    Raises ValueError where a block would not be three gaps long.
    """
    samples = context.samples
    spans = []
    for number in np.unique(samples.trajectory):
        time = samples.time[samples.trajectory == number]
        spans.append((int(number), float(time[0]), float(time[-1]) + 1e-6))
    total = sum(end - start for _, start, end in spans)
    count = max(VALIDATION.least, int(total / VALIDATION.duration))
    pieces = [1] * len(spans)
    while sum(pieces) < count:
        pieces[int(np.argmax([(e - s) / n for (_, s, e), n in zip(spans, pieces)]))] += 1
    blocks = []
    for (number, start, end), n in zip(spans, pieces):
        if (end - start) / n < VALIDATION.gaps_per_block * VALIDATION.gap:
            raise ValueError(
                f"expected {VALIDATION.least} blocks of motion of at least {VALIDATION.gaps_per_block * VALIDATION.gap:g} s, "
                f"{VALIDATION.shortest:g} s in all; got {total:.1f} s in {len(spans)} "
                f"pieces: record more (excite --only sweep_7 is enough)"
            )
        edges = np.linspace(start, end, n + 1)
        blocks += [TimeBlock(number, a, b) for a, b in zip(edges[:-1], edges[1:])]
    return tuple(blocks)


def make_cell(
    stages: ResidualStages,
    stage: Stage,
    joint: int,
    ids: np.ndarray,
    matrix: np.ndarray,
    blocks: Sequence[TimeBlock],
    parameters: Sequence[Parameter],
    whiten: np.ndarray | None = None,
    at_reversal: bool = False,
) -> ResidualCell:
    """Sums of one stage of one joint, with columns (n, p) `matrix` of the parameters `ids`.

    whiten: autoregression to use; None: from the data. at_reversal: of the rows about reversals, see `Stages.rows`.
    """
    trajectory, time = stages.times(stage)
    residual = stages.residual(stage, joint)
    counted = stages.rows(stage, joint, at_reversal)
    matrix, residual = stages.project_out_reference(stage, joint, counted, matrix, residual, at_reversal)
    kept = _kept(counted, trajectory)
    pieces = _pieces(trajectory, time, blocks)
    plain = _sums(matrix, residual, kept, np.zeros(0), pieces[:, [0, -1]])[0]
    if whiten is None:
        whiten = _autoregression(
            matrix,
            residual,
            kept,
            plain.sum(axis=0),
            np.array([parameters[i].prior * parameters[i].is_in_whitening for i in ids]),
        )
    sums = _sums(matrix, residual, kept, whiten, pieces)
    test = sums.sum(axis=0)
    held = test + _beside(sums[0], sums[2], pieces)
    counts = np.cumsum(np.concatenate([[0], kept]))
    head, body, tail = (counts[pieces[:, k + 1]] - counts[pieces[:, k]] for k in range(3))
    test_rows = (head + body + tail).astype(float)
    held_rows = test_rows + _beside(head.astype(float), tail.astype(float), pieces)
    block = np.full(len(time), -1)
    for b, (start, _, _, end) in enumerate(pieces):
        block[start:end] = b
    outside = float(np.square(residual[kept & (block < 0)]).sum())
    return ResidualCell(
        stage,
        joint,
        ids,
        test,
        held,
        test_rows,
        held_rows,
        plain,
        outside,
        matrix,
        residual,
        kept,
        block,
        whiten,
        at_reversal,
    )


def _kept(rows: np.ndarray, trajectory: np.ndarray) -> np.ndarray:
    """Rows (n,) that count and all of whose past in the autoregression counts."""
    kept = rows.copy()
    for lag in range(1, VALIDATION.order + 1):
        kept[lag:] &= rows[:-lag] & (trajectory[lag:] == trajectory[:-lag])
        kept[:lag] = False
    return kept


def _pieces(trajectory: np.ndarray, time: np.ndarray, blocks: Sequence[TimeBlock]) -> np.ndarray:
    """Rows (m, 4) at which each block starts, its first `VALIDATION.gap` ends, its last `VALIDATION.gap` starts, and it ends."""
    pieces = []
    for part in blocks:
        first, last = np.searchsorted(trajectory, [part.trajectory, part.trajectory + 1])
        edges = np.searchsorted(
            time[first:last], [part.start, part.start + VALIDATION.gap, part.end - VALIDATION.gap, part.end]
        )
        pieces.append(first + np.maximum.accumulate(edges))
    return np.array(pieces)


def _sums(
    matrix: np.ndarray, residual: np.ndarray, kept: np.ndarray, whiten: np.ndarray, pieces: np.ndarray
) -> np.ndarray:
    """Gram matrices (k, m, p + 1, p + 1) of columns and residual through the autoregression's inverse, of the k parts
    of each block that lie between its rows `pieces` (m, k + 1). A block at a time fits into the cache."""
    size, lags, number = matrix.shape[1] + 1, len(whiten), pieces.shape[1] - 1
    parts = np.zeros((number, len(pieces), size, size))
    for b, edges in enumerate(pieces):
        start, end = max(edges[0], lags), edges[-1]
        if not kept[start:end].any():
            continue
        rows = slice(start - lags, end)
        whole = np.vstack([matrix[rows].T, residual[rows]])
        white = whole[:, lags:] if not lags else whole[:, lags:].copy()
        late = np.empty_like(white)
        for lag, c in enumerate(whiten, 1):
            if c:
                white -= np.multiply(whole[:, lags - lag : -lag], c, out=late)
        counts = np.concatenate([[0], np.cumsum(kept[start:end])])  # rows before each that count, which may be few
        white = white if counts[-1] == end - start else white[:, kept[start:end]]
        for k in range(number):
            part = white[:, counts[max(edges[k] - start, 0)] : counts[max(edges[k + 1] - start, 0)]]
            parts[k, b] = part @ part.T
    return parts


def _beside(head: np.ndarray, tail: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    """What the neighbours of each block have next to it: the tail of the one before, the head of the next."""
    beside = np.zeros_like(head)
    touching = np.flatnonzero(pieces[1:, 0] == pieces[:-1, 3])
    for before in touching:
        beside[before + 1] += tail[before]
    for before in touching:
        beside[before] += head[before + 1]
    return beside


def _autoregression(matrix, residual, kept, normal, prior) -> np.ndarray:
    """Coefficients of what all columns together leave in the rows `kept`, by Yule and Walker; zeros where too
    short. normal (p + 1, p + 1): Gram matrix of columns and residual."""
    side = residual[kept]
    if len(side) < VALIDATION.order_rows:
        return np.zeros(VALIDATION.order)
    if len(prior):
        scaled = normal[:-1, :-1] * np.outer(prior, prior)
        # Without noise the ridge must still be seen beside the columns in double precision.
        spread = max(np.median(np.abs(side)) ** 2, 1e-12, ROUNDING * np.diagonal(scaled).max())
        scaled = scaled + spread * np.eye(len(prior))
        side = side - (matrix @ (prior * np.linalg.solve(scaled, prior * normal[:-1, -1])))[kept]
    correlation = np.array([np.mean(side[lag:] * side[: len(side) - lag]) for lag in range(VALIDATION.order + 1)])
    if correlation[0] <= 1e-20:
        return np.zeros(VALIDATION.order)
    table = correlation[np.abs(np.subtract.outer(np.arange(VALIDATION.order), np.arange(VALIDATION.order)))]
    return np.linalg.solve(table + VALIDATION.order_ridge * correlation[0] * np.eye(VALIDATION.order), correlation[1:])
