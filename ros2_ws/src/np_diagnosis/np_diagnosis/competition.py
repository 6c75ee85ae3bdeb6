"""Structures of one joint compete: nothing, every effect, every pair of effects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from np_diagnosis.design import NUISANCES, Design, Sums
from np_diagnosis.fit import Score, score

PRIOR = (0.5, 0.3, 0.12, 0.05, 0.03)  # by the number of parameters, shared among structures of as many
TIE = 1.0  # nats within which fewer effects are preferred
DRAWS = 2000
T95 = 2.26  # Student's t with 9 degrees of freedom: a joint is judged from ten blocks or few more
LEAST_GAIN = 0.03  # of the held-out RMSE, below which an addition is not worth naming
LEAST_SHARE = 0.02  # of the held-out energy without any effect, likewise
VISIBLE = 0.0005  # of the joint's torque limit, likewise


@dataclass(frozen=True, eq=False)
class Structure:
    """Effects by key, the indices of their columns (nuisances first), and how they predict."""

    keys: tuple[str, ...]
    columns: np.ndarray
    score: Score

    @property
    def size(self) -> int:
        """Parameters besides the nuisances."""
        return len(self.columns) - NUISANCES

    @property
    def total(self) -> float:
        """Log predictive density of all blocks."""
        return float(self.score.density.sum())


@dataclass(frozen=True, eq=False)
class Competition:
    """All structures of a joint; `chosen` is the simplest that the data allow."""

    design: Design
    train: Sums
    test: Sums
    structures: list[Structure]
    chosen: Structure
    seed: int

    @property
    def null(self) -> Structure:
        """Nuisances only."""
        return self.structures[0]

    @cached_property
    def probabilities(self) -> np.ndarray:
        """Of the structures: pseudo-BMA+ (Yao et al., Bayesian Analysis 2018), weights from the log
        predictive
        density, averaged over the Bayesian bootstrap of the blocks."""
        density = np.array([s.score.density[s.score.used] for s in self.structures])
        sizes = np.array([s.size for s in self.structures])
        prior = np.log([PRIOR[size] / (sizes == size).sum() for size in sizes])
        rng = np.random.default_rng(self.seed)
        weights = rng.dirichlet(np.ones(density.shape[1]), DRAWS) * density.shape[1]
        logits = weights @ density.T + prior
        shares = np.exp(logits - logits.max(axis=1, keepdims=True))
        return (shares / shares.sum(axis=1, keepdims=True)).mean(axis=0)

    def rmse(self, structure: Structure) -> float:
        """Held-out RMSE, Nm."""
        used = self.design.used
        return float(np.sqrt(structure.score.squares.sum() / max(self.test.rows[used].sum(), 1)))

    def effect_probability(self, effect: str) -> float:
        """Probability of the structures that hold an effect of this id."""
        return float(
            sum(
                p
                for s, p in zip(self.structures, self.probabilities)
                if any(self.design.effects[key].id == effect for key in s.keys)
            )
        )


def compete(
    design: Design, train: Sums | None = None, test: Sums | None = None, pairs: bool = True, seed: int = 0
) -> Competition:
    """Score the structures of a joint, on other sums than the design's own where given."""
    train, test = train or design.train, test or design.test
    keys = [key for key, effect in design.effects.items() if not effect.is_arm]
    candidates = [(), *((key,) for key in keys)]
    if pairs:
        candidates += [pair for pair in combinations(keys, 2) if _is_independent(design, pair)]
    structures = []
    for names in candidates:
        columns = np.concatenate([np.arange(NUISANCES), *(design.columns[name] for name in names)])
        structures.append(Structure(names, columns, score(train, test, columns, design)))
    return Competition(design, train, test, structures, choose(structures, design), seed)


def choose(structures: list[Structure], design: Design) -> Structure:
    """The best of the simplest size that no larger one beats clearly and by an amount worth naming."""
    chosen = structures[0]
    least = max(
        LEAST_SHARE * chosen.score.squares.sum(),
        (VISIBLE * design.torque_limit) ** 2 * design.test.rows[design.used].sum(),
    )
    for size in sorted({s.size for s in structures} - {0}):
        equals = [s for s in structures if s.size == size]
        most = max(s.total for s in equals)
        best = min((s for s in equals if s.total >= most - TIE), key=lambda s: (len(s.keys), -s.total))
        if beats(best, chosen) and chosen.score.squares.sum() - best.score.squares.sum() > least:
            chosen = best
    return chosen


def beats(one: Structure, other: Structure) -> bool:
    """Whether `one` predicts clearly better than `other`, block by block."""
    difference = (one.score.density - other.score.density)[one.score.used]
    gain = 1 - np.sqrt(one.score.squares.sum() / max(other.score.squares.sum(), 1e-300))
    return bool(gain > LEAST_GAIN and difference.sum() > T95 * standard_error(difference))


def standard_error(difference: np.ndarray) -> float:
    """Of a sum over blocks, from its variation among them."""
    return float(np.sqrt(len(difference)) * difference.std(ddof=1))


def _is_independent(design: Design, pair: tuple[str, str]) -> bool:
    """Whether two effects are of different ids and neither holds what the other says."""
    if design.effects[pair[0]].id == design.effects[pair[1]].id:
        return False
    columns = np.concatenate([design.columns[key] for key in pair])
    gram = design.test.gram[:, columns[:, None], columns].sum(axis=0)
    scale = np.sqrt(np.diag(gram))
    if (scale == 0).any():
        return False
    return bool(np.linalg.eigvalsh(gram / np.outer(scale, scale))[0] > 1e-3)
