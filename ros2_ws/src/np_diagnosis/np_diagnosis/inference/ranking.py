"""How sure: probabilities of effects over all structures tried, and what the data cannot tell apart."""

from __future__ import annotations

import numpy as np

from np_diagnosis.inference.design import Candidate, Design
from np_diagnosis.inference.search import TRIED, Search, Structure

DRAWS = 1000
LEADERS = 400  # structures that count
SAME = 1e-4  # of a column's square, up to which others say what it says
EQUAL = 3.0  # nats within which two structures explain the same


def probabilities(search: Search, seed: int) -> dict[tuple[str, str], float]:
    """(effect id, component) -> probability: pseudo-BMA+ (Yao et al., Bayesian Analysis 2018), weights from the
    log predictive density averaged over the Bayesian bootstrap of the blocks."""
    ranked = sorted(search.tried.values(), key=search.value, reverse=True)[:LEADERS]
    density = np.array([s.density for s in ranked])
    prior = np.array([search.value(s) - s.density.sum() for s in ranked])
    weight = weigh(density, prior, seed)
    joints, found = search.design.context.arm.joints, {}
    for structure, share in zip(ranked, weight):
        names = {(c.effect.id, c.at(joints)) for c in (search.design.candidates[m] for m in structure.members)}
        for name in names:
            found[name] = min(1.0, found.get(name, 0.0) + float(share))
    return found


def weigh(density: np.ndarray, prior: np.ndarray, seed: int) -> np.ndarray:
    """Pseudo-BMA+ weights (s,) of structures with log predictive densities (s, m) of blocks and log odds (s,)."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(density.shape[1]), DRAWS) * density.shape[1]
    logits = weights @ density.T + prior
    shares = np.exp(logits - logits.max(axis=1, keepdims=True))
    return (shares / shares.sum(axis=1, keepdims=True)).mean(axis=0)


def alternatives(search: Search, chosen: Structure, member: int) -> tuple[str, ...]:
    """Ids that could stand in a chosen one's place without predicting worse by a telling amount."""
    design, found = search.design, set()
    mine = design.candidates[member]
    rest = tuple(m for m in chosen.members if m != member)
    taken = {(design.candidates[m].effect.id, design.candidates[m].joint) for m in chosen.members}
    for n in search.promising(search.structure(rest), TRIED):
        candidate = design.candidates[n]
        same_place = candidate.joint == mine.joint or candidate.joint is None or mine.joint is None
        if not same_place or (candidate.effect.id, candidate.joint) in taken or candidate.effect.id == mine.effect.id:
            continue
        if candidate.joint is None and not search.reach(candidate):
            continue
        other = search.structure((*rest, n))
        if search.is_trifle(other, n):
            continue
        difference = chosen.density - other.density
        error = float(np.sqrt(len(difference)) * difference.std(ddof=1))
        if chosen.total - other.total < max(EQUAL, min(error, 8.0)):
            found.add(candidate.effect.id)
    return tuple(sorted(found))


def larger(search: Search, member: int) -> tuple[str, ...]:
    """Ids of effects at a member's place that can be that very effect with some of their parameters settled,
    as asymmetric friction with equal levels is plain friction: they contradict nothing."""
    design, mine = search.design, search.design.candidates[member]
    found = set()
    for other in design.candidates:
        at_place = other.joint == mine.joint and other.effect.component == mine.effect.component
        is_larger = len(other.ids) > len(mine.ids) and other.effect.id != mine.effect.id
        if at_place and is_larger and spans(design, other, mine):
            found.add(other.effect.id)
    return tuple(sorted(found))


def spans(design: Design, one: Candidate, other: Candidate) -> bool:
    """Whether the columns of one candidate can say all that another's say, wherever those show."""
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
        if (shown - (mixed * np.linalg.solve(inner, mixed)).sum(axis=0) > SAME * shown).any():
            return False
    return True
