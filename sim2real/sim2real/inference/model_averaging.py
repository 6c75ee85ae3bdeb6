"""Intervals that include rival models: the estimates of a parameter by the other probable models.

Bayesian model averaging with the weights of `ranking` (pseudo-BMA+), over all groups of effects that were scored and
hold the effect: with and without other effects, and with other nonlinear parameters.
"""

from __future__ import annotations

import numpy as np

from sim2real.inference.ranking import is_in_column_space, pseudo_bma_weights
from sim2real.inference.regression import Candidate
from sim2real.inference.search import ModelSearch

LEADERS = 60  # groups of effects that are averaged
SMALLEST_WEIGHT = 1e-3  # of a group that counts


def between_model_deviations(
    search: ModelSearch, joints: tuple[int, ...], inside: tuple[int, ...], member: int, seed: int
) -> dict[str, float]:
    """Standard deviation of each parameter (by name) of a member of a group between models, about the group's value."""
    design, mine = search.design, search.design.candidates[member]
    rivals, known = [], {}

    def overlap(one: int, other: int) -> bool:
        """Whether the columns of one of two members span those of the other: data cannot divide a torque between them."""
        if (one, other) not in known:
            pair = design.candidates[one], design.candidates[other]
            near = pair[0].joint == pair[1].joint and pair[0].effect.component == pair[1].effect.component
            known[one, other] = near and (is_in_column_space(design, *pair) or is_in_column_space(design, *pair[::-1]))
        return known[one, other]

    for others in search.list_scored_groups(joints):
        same = [n for n in others if _is_same(design.candidates[n], mine)]
        if same and not any(overlap(same[0], n) for n in others if n != same[0]):
            rivals.append((search.group_value(joints, others), others, same[0]))
    rivals = sorted(rivals, key=lambda r: -r[0])[:LEADERS]
    if (inside, member) not in [r[1:] for r in rivals]:
        return {}
    scores = [search.group(joints, others)[0] for _, others, _ in rivals]
    density = np.array([s.density for s in scores])
    prior = np.array([value for value, _, _ in rivals]) - density.sum(axis=1)
    weights = pseudo_bma_weights(density, prior, seed)
    own = _meaning(search, joints, inside, member)
    variance = dict.fromkeys(own, 0.0)
    for weight, (_, others, number) in zip(weights, rivals):
        if weight < SMALLEST_WEIGHT:
            continue
        for name, value in _meaning(search, joints, others, number).items():
            if name in own:
                variance[name] += weight * (value - own[name]) ** 2
    return {name: float(np.sqrt(v)) for name, v in variance.items()}


def _is_same(one: Candidate, other: Candidate) -> bool:
    """Whether two candidates are the same effect at the same place, whatever its nonlinear parameter."""
    names = [(c.effect.id, c.joint, c.effect.component) for c in (one, other)]
    return names[0] == names[1]


def _meaning(search: ModelSearch, joints: tuple[int, ...], inside: tuple[int, ...], member: int) -> dict[str, float]:
    """Values of a member's parameters in the fit of a group, by the names that a report gives them."""
    candidate = search.design.candidates[member]
    ids = search.ids(joints, inside)
    values = search.group(joints, inside)[0].fit.parameters.mean(axis=0)
    found = {
        p.name: float(values[np.flatnonzero(ids == i)[0]]) for p, i in zip(candidate.effect.parameters, candidate.ids)
    }
    nonlinear = candidate.effect.nonlinear
    if nonlinear is None:
        return found
    share = found.pop("share", 1.0)
    return {**found, nonlinear.name: nonlinear.value * share if nonlinear.linear else nonlinear.value}
