"""Which effect costs how much: Shapley values of the success that is lost, over all subsets of the effects, on the same episodes.

An effect's share is what it costs on top of those that are there already, averaged over all orders in which they could come. Shares sum to
what all of them cost together. Shapley, A value for n-person games, 1953.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from math import factorial

import numpy as np
from sim2real.effects.patch import Patch, PatchEffect

MOST = 5  # parts, of which all subsets are played: 32
DRAWS = 2000  # of the bootstrap over episodes
Subset = frozenset[str]


def split_patch(patch: Patch) -> dict[str, Patch]:
    """The patch cut into parts that are blamed: single effects where these are few, else effects of a kind together, of a module, or of
    arm, view and scene."""
    for label in (_alone, _kind, _module, _whose):
        found: dict[str, list[PatchEffect]] = {}
        for effect in patch.effects:
            found.setdefault(label(effect), []).append(effect)
        if len(found) <= MOST:
            break
    return {name: Patch(tuple(effects)) for name, effects in found.items()}


def _alone(effect: PatchEffect) -> str:
    return f"{effect.effect} at {effect.component}"


def _kind(effect: PatchEffect) -> str:
    return effect.effect


def _module(effect: PatchEffect) -> str:
    return effect.definition.module


def _whose(effect: PatchEffect) -> str:
    return next(name for name in ("arm", "view", "scene") if getattr(Patch((effect,)), name).effects)


def subsets(names: Sequence[str]) -> list[Subset]:
    """All of them, the empty one first."""
    return [frozenset(some) for size in range(len(names) + 1) for some in combinations(names, size)]


def join_patches(patches: Mapping[str, Patch], some: Subset) -> Patch:
    """The parts of a subset together."""
    return Patch(tuple(effect for name, patch in patches.items() if name in some for effect in patch.effects))


def shapley(names: Sequence[str], success: Mapping[Subset, np.ndarray]) -> dict[str, np.ndarray]:
    """Cost of each part in every episode's success (n,). success: by subset, 1 or 0 an episode, the same ones for all subsets."""
    n = len(names)
    costs = {}
    for name in names:
        others = [other for other in names if other != name]
        costs[name] = sum(
            factorial(len(some))
            * factorial(n - len(some) - 1)
            / factorial(n)
            * (success[some] - success[some | {name}])
            for some in subsets(others)
        )
    return costs


def with_intervals(costs: Mapping[str, np.ndarray]) -> dict[str, dict]:
    """Mean cost by part, the largest first, with its 95 % interval by the bootstrap over episodes."""
    found = {name: mean_and_interval(each) for name, each in costs.items()}
    return dict(sorted(found.items(), key=lambda item: -item[1]["value"]))


def mean_and_interval(each: np.ndarray) -> dict:
    """{value, ci95} of the mean of numbers (n,), by the bootstrap."""
    rows = np.random.default_rng(0).integers(len(each), size=(DRAWS, len(each)))
    low, high = np.quantile(each[rows].mean(axis=1), [0.025, 0.975])
    return {"value": float(np.mean(each)), "ci95": [float(low), float(high)]}
