"""How sure: probabilities of effects over all models tried, and which effects these data cannot distinguish."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim2real.effects import ARM_EFFECTS
from sim2real.inference.regression import Candidate, RegressionProblem
from sim2real.inference.search import ModelSearch, ScoredModel
from sim2real.thresholds import THRESHOLDS

RANKING = THRESHOLDS.ranking
DRAWS = 1000  # of the Bayesian bootstrap over blocks
LEADERS = 400  # models that get a probability
SPAN = 1e-4  # of a column's squares that columns which span it may leave


def effect_probabilities(search: ModelSearch, seed: int) -> dict[tuple[str, str], float]:
    """(effect id, component) -> probability: pseudo-BMA+ (Yao et al., Bayesian Analysis 2018), weights from the
    log predictive density averaged over the Bayesian bootstrap of the blocks."""
    ranked = sorted(search.tried.values(), key=search.value, reverse=True)[:LEADERS]
    density = np.array([s.density for s in ranked])
    prior = np.array([search.value(s) - s.density.sum() for s in ranked])
    weight = pseudo_bma_weights(density, prior, seed)
    joints, found = search.design.context.arm.joints, {}
    for model, share in zip(ranked, weight):
        names = {(c.effect.id, c.component(joints)) for c in (search.design.candidates[m] for m in model.members)}
        for name in sorted(names):  # equally probable ones keep an order that does not depend on hashes
            found[name] = min(1.0, found.get(name, 0.0) + float(share))
    return found


def pseudo_bma_weights(density: np.ndarray, prior: np.ndarray, seed: int) -> np.ndarray:
    """Pseudo-BMA+ weights (s,) of models with log predictive densities (s, m) of blocks and log priors (s,)."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(density.shape[1]), DRAWS) * density.shape[1]
    logits = weights @ density.T + prior
    shares = np.exp(logits - logits.max(axis=1, keepdims=True))
    return (shares / shares.sum(axis=1, keepdims=True)).mean(axis=0)


def find_competing_effects(search: ModelSearch, chosen: ScoredModel, member: int) -> tuple[str, ...]:
    """Ids of effects that could stand in a chosen one's place without predicting clearly worse; none for the background."""
    design, found = search.design, set()
    if member in search.background:
        return ()
    mine = design.candidates[member]
    others = search.model(tuple(m for m in chosen.members if m != member))
    for n in search.rank_candidates(others, THRESHOLDS.search.tried):
        candidate = design.candidates[n]
        same_place = candidate.joint == mine.joint or candidate.joint is None or mine.joint is None
        if not same_place or candidate.effect.id == mine.effect.id or not search.can_extend(others, n):
            continue
        other = search.model((*others.members, n))
        if search.is_negligible(other, n):
            continue
        difference = chosen.density - other.density
        error = float(np.sqrt(len(difference)) * difference.std(ddof=1))
        if chosen.total - other.total < max(RANKING.equal, min(error, RANKING.equal_most)):
            found.add(candidate.effect.id)
    return tuple(sorted(found))


def find_generalisations(search: ModelSearch, member: int) -> tuple[str, ...]:
    """Ids of effects at a member's place of which the member is a special case.

    Asymmetric friction, for one, is plain friction where its two levels are equal. Such effects do not contradict it; what
    is another cause of the same forces (`_is_another_cause`) does.
    """
    design, mine = search.design, search.design.candidates[member]
    larger: dict[str, bool] = {}  # id: whether a variant of it is another cause
    for other in design.candidates:
        at_place = other.joint == mine.joint and other.effect.component == mine.effect.component
        has_more = len(other.ids) > len(mine.ids) and other.effect.id != mine.effect.id
        if at_place and mine.effect.id in ARM_EFFECTS[other.effect.id].special_cases:
            larger[other.effect.id] = False
        elif at_place and has_more and is_in_column_space(design, other, mine):
            name = other.effect.id
            larger[name] = larger.get(name, False) or _is_another_cause(design, other, mine)
    return tuple(sorted(name for name, is_other in larger.items() if not is_other))


def _is_another_cause(design: RegressionProblem, larger: Candidate, mine: Candidate) -> bool:
    """Whether an effect that explains what a smaller one does is a cause elsewhere: of another module, with all of its parameters.

    Friction with equal and opposite levels is the torque of an offset, and a fault of the joint, not of its drive. A cable
    explains it with one of its parameters alone: a cable without stiffness is none.
    """
    if ARM_EFFECTS[larger.effect.id].module == ARM_EFFECTS[mine.effect.id].module:
        return False
    fewer = (replace(larger, ids=np.delete(larger.ids, k)) for k in range(len(larger.ids)))
    return not any(is_in_column_space(design, one, mine) for one in fewer)


def is_in_column_space(design: RegressionProblem, one: Candidate, other: Candidate) -> bool:
    """Whether the columns of one candidate span those of another in every cell in which those show."""
    for cell in design.cells:
        own, its = (np.flatnonzero(np.isin(cell.ids, c.ids)) for c in (one, other))
        gram = cell.total
        shown = np.diag(gram)[its]
        if not (shown > 0).any():
            continue
        own = own[np.diag(gram)[own] > 0]
        if not own.size:
            return False
        scale = np.sqrt(np.diag(gram)[own])
        inner = gram[np.ix_(own, own)] / np.outer(scale, scale) + 1e-9 * np.eye(len(own))
        mixed = gram[np.ix_(own, its)] / scale[:, None]
        if (shown - (mixed * np.linalg.solve(inner, mixed)).sum(axis=0) > SPAN * shown).any():
            return False
    return True
