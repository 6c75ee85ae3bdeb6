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
class Shape:
    """Which of p parameters are in which block (by the number of its group), and which (s,) are in the border."""

    size: int
    blocks: dict[int, np.ndarray]
    border: np.ndarray

    @classmethod
    def of(cls, groups: Sequence[int], members: Sequence[np.ndarray], size: int) -> Shape:
        """Of `size` parameters, of which several equations, each of one of the groups, hold the `members` (k,)."""
        owner = np.full(size, -1)
        for group, own in zip(groups, members):
            owner[own] = np.where((owner[own] == -1) | (owner[own] == group), group, -2)
        return cls(size, {g: np.flatnonzero(owner == g) for g in sorted(set(groups))}, np.flatnonzero(owner < 0))

    def places(self, group: int, members: np.ndarray) -> np.ndarray:
        """Where parameters (k,) stand in their group's block with the border behind it."""
        at = np.full(self.size, -1)
        block = self.blocks[group]
        at[block], at[self.border] = np.arange(len(block)), len(block) + np.arange(len(self.border))
        return at[members]


@dataclass(frozen=True, eq=False)
class Arrow:
    """m matrices of one shape, positive definite: of each block its part (m, k + s, k + s) with its own share of the
    border; corner (m, s, s): what of the border is no block's."""

    shape: Shape
    parts: dict[int, np.ndarray]
    corner: np.ndarray = field(repr=False)

    @classmethod
    def diagonal(cls, shape: Shape, count: int, values: np.ndarray) -> Arrow:
        """`count` diagonal matrices of these values (p,)."""
        border = len(shape.border)
        parts = {g: np.zeros((count, len(b) + border, len(b) + border)) for g, b in shape.blocks.items()}
        for g, b in shape.blocks.items():
            parts[g][:, np.arange(len(b)), np.arange(len(b))] = values[b]
        return cls(shape, parts, np.tile(np.diag(values[shape.border]), (count, 1, 1)))

    def on_diagonal(self, rows: np.ndarray) -> np.ndarray:
        """The diagonals (n, p) of the matrices that `rows` (n,) name."""
        border = self.shape.border
        found = np.empty((len(rows), self.shape.size))
        found[:, border] = np.diagonal(self.corner[rows], axis1=1, axis2=2)
        for g, b in self.shape.blocks.items():
            own = np.diagonal(self.parts[g][rows], axis1=1, axis2=2)
            found[:, b] = own[:, : len(b)]
            found[:, border] += own[:, len(b) :]
        return found

    def solve(self, values: np.ndarray, rows: np.ndarray, more: np.ndarray | None = None) -> np.ndarray:
        """(n, p) solutions for values (n, p) of the matrices that `rows` (n,) name; more (n, p): added to their diagonals."""
        found, border = np.empty_like(values), self.shape.border
        corner, left = self.corner[rows], values[:, border]
        if more is not None:
            corner = corner + more[:, border, None] * np.eye(len(border))
        inner = {}
        for g, b in self.shape.blocks.items():
            k, part = len(b), self.parts[g][rows]
            if more is not None:
                part[:, np.arange(k), np.arange(k)] += more[:, b]
            x = np.linalg.solve(part[:, :k, :k], np.concatenate([part[:, :k, k:], values[:, b, None]], axis=2))
            tied = np.matmul(part[:, k:, :k], x)
            corner, left = corner + part[:, k:, k:] - tied[..., :-1], left - tied[..., -1]
            inner[g] = x
        found[:, border] = np.linalg.solve(corner, left[..., None])[..., 0]
        for g, b in self.shape.blocks.items():
            found[:, b] = inner[g][..., -1] - np.matmul(inner[g][..., :-1], found[:, border, None])[..., 0]
        return found

    def inverse(self) -> np.ndarray:
        """(m, p, p) inverses."""
        border, count = self.shape.border, len(self.corner)
        ties, corner = np.zeros((count, self.shape.size, len(border))), self.corner
        inverses = {}
        for g, b in self.shape.blocks.items():
            k, part = len(b), self.parts[g]
            inverses[g] = np.linalg.inv(part[:, :k, :k])
            ties[:, b] = -np.matmul(inverses[g], part[:, :k, k:])
            corner = corner + part[:, k:, k:] + np.matmul(part[:, k:, :k], ties[:, b])
        ties[:, border] = np.eye(len(border))
        found = np.matmul(np.matmul(ties, np.linalg.inv(corner)), ties.transpose(0, 2, 1))
        for g, b in self.shape.blocks.items():
            found[:, b[:, None], b] += inverses[g]
        return found
