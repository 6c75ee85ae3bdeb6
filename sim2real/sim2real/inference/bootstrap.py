"""The bootstrap over blocks or windows of a recording, which are exchangeable where its samples are not."""

from __future__ import annotations

import numpy as np


def draw_counts(blocks: int, draws: int, seed: int) -> np.ndarray:
    """How often each block is in each draw with replacement (draws, blocks), integers; every draw has as many as there are blocks."""
    return np.random.default_rng(seed).multinomial(blocks, np.full(blocks, 1 / blocks), draws)
