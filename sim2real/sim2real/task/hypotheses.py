"""Which effects explain a few numbers that were measured with a covariance: competing explanations, rivals, intervals, abstention.

Numbers are changes against what is believed. Each is as a set-up that is well has it, or a gap; both are Gaussians about zero, so that
the probability of what was measured under each explanation is exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import multivariate_normal

from sim2real.effects.sentences import ValueWithInterval
from sim2real.thresholds import THRESHOLDS

FELT = THRESHOLDS.felt
HALF_WIDTH = 1.959964  # standard deviations of a 95 % interval
Names = frozenset[str]


@dataclass(frozen=True, eq=False)
class MeasuredChanges:
    """names of the numbers (k); value (k,) and covariance (k, k); usual and gap (k,): standard deviations of a number of a set-up that is
    well, and of one that is not. effects: numbers of each effect that may be a gap."""

    names: tuple[str, ...]
    value: np.ndarray
    covariance: np.ndarray
    usual: np.ndarray
    gap: np.ndarray
    effects: Mapping[str, tuple[str, ...]]

    def spread(self, gaps: Names) -> np.ndarray:
        """Standard deviations (k,) of the numbers beforehand, where these effects are gaps."""
        free = {number for effect in gaps for number in self.effects[effect]}
        return np.array([np.hypot(u, g) if n in free else u for n, u, g in zip(self.names, self.usual, self.gap)])

    def evidence(self, gaps: Names) -> float:
        """Nats of what was measured, with the price of each gap."""
        total = self.covariance + np.diag(self.spread(gaps) ** 2)
        return float(multivariate_normal(np.zeros(len(self.value)), total).logpdf(self.value)) - len(gaps) * np.log(
            FELT.prior
        )

    def posterior(self, gaps: Names) -> tuple[np.ndarray, np.ndarray]:
        """Mean (k,) and standard deviation (k,) of the numbers where these effects are gaps."""
        before = np.diag(self.spread(gaps) ** 2)
        gain = before @ np.linalg.inv(before + self.covariance)
        return gain @ self.value, np.sqrt(np.maximum(np.diag(before - gain @ before), 0.0))


@dataclass(frozen=True)
class Named:
    """An effect that is named. sizes: of its numbers; gain: nats by which what was felt is more probable with it; rivals: effects that
    explain as well in its place, with their sizes."""

    effect: str
    sizes: dict[str, ValueWithInterval]
    gain: float
    rivals: dict[str, dict[str, ValueWithInterval]]


@dataclass(frozen=True)
class HypothesisComparison:
    """verdict: no_gap, identified, ambiguous, undetermined. bounds: every number, were its effect a gap; unseen: those that were hardly
    narrowed."""

    verdict: str
    named: tuple[Named, ...]
    bounds: dict[str, ValueWithInterval]
    unseen: tuple[str, ...]


def compare_hypotheses(measured: MeasuredChanges) -> HypothesisComparison:
    """The best explanation of up to two effects."""
    every = [frozenset(c) for size in range(3) for c in combinations(measured.effects, size)]
    value = {gaps: measured.evidence(gaps) for gaps in every}
    best = max(every, key=value.__getitem__)
    while best:
        less = max((best - {effect} for effect in best), key=value.__getitem__)
        if value[best] - value[less] >= FELT.gain:
            break
        best = less
    named = tuple(_named(measured, value, best, effect) for effect in sorted(best))
    bounds = {n: s for effect in measured.effects for n, s in _sizes(measured, best | {effect}, effect).items()}
    wide = {n: HALF_WIDTH * FELT.narrowed * g for n, g in zip(measured.names, measured.gap)}
    unseen = tuple(n for n, v in bounds.items() if (v.high - v.low) / 2 > wide[n] and v.low <= 0 <= v.high)
    if named:
        verdict = "ambiguous" if any(one.rivals for one in named) else "identified"
    else:
        verdict = "undetermined" if len(unseen) == len(measured.names) else "no_gap"
    return HypothesisComparison(verdict, named, bounds, unseen)


def _named(measured: MeasuredChanges, value: Mapping[Names, float], best: Names, effect: str) -> Named:
    rest = best - {effect}
    near = [
        n
        for n in value
        if len(n) == len(best) and rest <= n and effect not in n and value[best] - value[n] < FELT.equal
    ]
    rivals = {other: _sizes(measured, n, other) for n in near for other in n - rest}
    return Named(effect, _sizes(measured, best, effect), value[best] - value[rest], rivals)


def _sizes(measured: MeasuredChanges, gaps: Names, effect: str) -> dict[str, ValueWithInterval]:
    mean, deviation = measured.posterior(gaps)
    rows = [measured.names.index(number) for number in measured.effects[effect]]
    return {
        measured.names[k]: ValueWithInterval(
            float(mean[k]), float(mean[k] - HALF_WIDTH * deviation[k]), float(mean[k] + HALF_WIDTH * deviation[k])
        )
        for k in rows
    }
