"""Normal equations that are an arrow: blocks that have nothing to do with one another, and a border shared by all.

So are those of several joints: what a joint's nuisances and effects are fitted to is its own, and only the parameters of
effects of the whole arm tie joints together. By Schur's complement seven joints cost seven small systems in place of one
large one (Golub and Van Loan, Matrix Computations, 4.4.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class BlockArrowStructure:
    """Which of p parameters are in which block (by the number of its group), and which (s,) are in the border."""

    size: int
    blocks: dict[int, np.ndarray]
    border: np.ndarray

    @classmethod
    def from_members(cls, groups: Sequence[int], members: Sequence[np.ndarray], size: int) -> BlockArrowStructure:
        """Of `size` parameters, of which several equations, each of one of the groups, hold the `members` (k,)."""
        owner = np.full(size, -1)
        for group, own in zip(groups, members):
            owner[own] = np.where((owner[own] == -1) | (owner[own] == group), group, -2)
        return cls(size, {g: np.flatnonzero(owner == g) for g in sorted(set(groups))}, np.flatnonzero(owner < 0))

    def local_indices(self, group: int, members: np.ndarray) -> np.ndarray:
        """Where parameters (k,) stand in their group's block with the border behind it."""
        at = np.full(self.size, -1)
        block = self.blocks[group]
        at[block], at[self.border] = np.arange(len(block)), len(block) + np.arange(len(self.border))
        return at[members]


@dataclass(frozen=True, eq=False)
class BlockArrowSystem:
    """m matrices of one shape, positive definite: of each block its part (m, k + s, k + s) with its own share of the
    border; corner (m, s, s): what of the border is no block's."""

    shape: BlockArrowStructure
    parts: dict[int, np.ndarray]
    corner: np.ndarray = field(repr=False)

    @classmethod
    def diagonal(cls, shape: BlockArrowStructure, count: int, values: np.ndarray) -> BlockArrowSystem:
        """`count` diagonal matrices of these values (p,)."""
        border = len(shape.border)
        parts = {g: np.zeros((count, len(b) + border, len(b) + border)) for g, b in shape.blocks.items()}
        for g, b in shape.blocks.items():
            parts[g][:, np.arange(len(b)), np.arange(len(b))] = values[b]
        return cls(shape, parts, np.tile(np.diag(values[shape.border]), (count, 1, 1)))

    def diagonals(self, rows: np.ndarray) -> np.ndarray:
        """The diagonals (n, p) of the matrices that `rows` (n,) name."""
        border = self.shape.border
        found = np.empty((len(rows), self.shape.size))
        found[:, border] = np.diagonal(self.corner[rows], axis1=1, axis2=2)
        for g, b in self.shape.blocks.items():
            own = np.diagonal(self.parts[g][rows], axis1=1, axis2=2)
            found[:, b] = own[:, : len(b)]
            found[:, border] += own[:, len(b) :]
        return found

    def solve(self, values: np.ndarray) -> BlockArrowSolution:
        """Solutions for values (m, p)."""
        inner = {}
        for g, b in self.shape.blocks.items():
            k, part = len(b), self.parts[g]
            inner[g] = np.linalg.solve(part[:, :k, :k], np.concatenate([part[:, :k, k:], values[:, b, None]], axis=2))
        return self._tied(inner, values, slice(None), self.corner)

    def solve_again(
        self, before: BlockArrowSolution, values: np.ndarray, rows: np.ndarray, more: np.ndarray
    ) -> BlockArrowSolution:
        """Of the matrices that `rows` (n,) name, with more (n, p) on their diagonals, for values (n, p), which differ from those
        of `before` where that is not zero: a block in which nothing is added stays as it was solved."""
        inner, border = {}, self.shape.border
        for g, b in self.shape.blocks.items():
            k, x = len(b), before.inner[g][rows]
            new = np.flatnonzero(more[:, b].any(axis=1))
            if len(new):
                part = self.parts[g][rows[new]]
                part[:, np.arange(k), np.arange(k)] += more[new[:, None], b]
                x[new] = np.linalg.solve(
                    part[:, :k, :k], np.concatenate([part[:, :k, k:], values[new[:, None], b, None]], axis=2)
                )
            inner[g] = x
        return self._tied(inner, values, rows, self.corner[rows] + more[:, border, None] * np.eye(len(border)))

    def _tied(self, inner: dict[int, np.ndarray], values: np.ndarray, rows, corner: np.ndarray) -> BlockArrowSolution:
        """Blocks solved each by itself, put together at the border."""
        found, border = np.empty_like(values), self.shape.border
        left = values[:, border]
        for g, b in self.shape.blocks.items():
            k, part = len(b), self.parts[g][rows, len(b) :]
            tied = np.matmul(part[:, :, :k], inner[g])
            corner, left = corner + part[:, :, k:] - tied[..., :-1], left - tied[..., -1]
        found[:, border] = np.linalg.solve(corner, left[..., None])[..., 0]
        for g, b in self.shape.blocks.items():
            found[:, b] = inner[g][..., -1] - np.matmul(inner[g][..., :-1], found[:, border, None])[..., 0]
        return BlockArrowSolution(found, inner)

    def inverse(self) -> BlockArrowInverse:
        """Of each matrix, its inverse."""
        corner, own, ties = self.corner, {}, {}
        for g, b in self.shape.blocks.items():
            k, part = len(b), self.parts[g]
            own[g] = np.linalg.inv(part[:, :k, :k])
            ties[g] = -np.matmul(own[g], part[:, :k, k:])
            corner = corner + part[:, k:, k:] + np.matmul(part[:, k:, :k], ties[g])
        return BlockArrowInverse(self.shape, own, ties, np.linalg.inv(corner))


@dataclass(frozen=True, eq=False)
class BlockArrowSolution:
    """Values (m, p); inner: of each block alone what it gives for its ties to the border and for its values, (m, k, s + 1)."""

    values: np.ndarray
    inner: dict[int, np.ndarray]


@dataclass(frozen=True, eq=False)
class BlockArrowInverse:
    """m inverses of arrows: of each block alone (m, k, k), what ties it to the border (m, k, s), the border's (m, s, s).

    An arrow's inverse is full, but the part between two blocks is most of it and seldom needed.
    """

    shape: BlockArrowStructure
    own: dict[int, np.ndarray]
    ties: dict[int, np.ndarray]
    corner: np.ndarray

    def multiply(self, values: np.ndarray) -> BlockArrowSolution:
        """Products (m, p) with values (m, p)."""
        found, border, inner = np.empty_like(values), self.shape.border, {}
        sums = values[:, border, None]
        for g, b in self.shape.blocks.items():
            sums = sums + np.matmul(self.ties[g].transpose(0, 2, 1), values[:, b, None])
        shared = np.matmul(self.corner, sums)
        found[:, border] = shared[..., 0]
        for g, b in self.shape.blocks.items():
            alone = np.matmul(self.own[g], values[:, b, None])
            found[:, b] = (alone + np.matmul(self.ties[g], shared))[..., 0]
            inner[g] = np.concatenate([-self.ties[g], alone], axis=2)
        return BlockArrowSolution(found, inner)

    def block(self, group: int) -> np.ndarray:
        """Of a block with the border behind it (m, k + s, k + s), in the order of `BlockArrowStructure.local_indices`."""
        own, ties = self.own[group], self.ties[group]
        k, tied = own.shape[-1], np.matmul(ties, self.corner)
        found = np.empty((len(own), k + tied.shape[-1], k + tied.shape[-1]))
        found[:, :k, :k] = own + np.matmul(tied, ties.transpose(0, 2, 1))
        found[:, :k, k:], found[:, k:, :k] = tied, tied.transpose(0, 2, 1)
        found[:, k:, k:] = self.corner
        return found

    def dense(self) -> np.ndarray:
        """All of them (m, p, p)."""
        border, count = self.shape.border, len(self.corner)
        ties = np.zeros((count, self.shape.size, len(border)))
        ties[:, border] = np.eye(len(border))
        for g, b in self.shape.blocks.items():
            ties[:, b] = self.ties[g]
        found = np.matmul(np.matmul(ties, self.corner), ties.transpose(0, 2, 1))
        for g, b in self.shape.blocks.items():
            found[:, b[:, None], b] += self.own[g]
        return found
