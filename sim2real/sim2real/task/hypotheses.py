"""Competing hypotheses: which effects explain what was recorded, by Bayesian model comparison.

A hypothesis is a set of effects that are off. Its value is the log evidence of the recording under it, less log n for each effect, where n is the
number of equally probable effects that each is one of. An effect is found where it raises the value by MIN_LOG_BAYES_FACTOR or more; effects
whose hypotheses lie within INDISTINGUISHABLE_LOG_BAYES_FACTOR of each other are reported together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from scipy.stats import multivariate_normal

from sim2real.effects.catalogue import catalogue
from sim2real.effects.sentences import ValueWithInterval
from sim2real.thresholds import THRESHOLDS

N_EQUALLY_LIKELY_CANDIDATES = THRESHOLDS.hypotheses.candidates
MIN_LOG_BAYES_FACTOR = THRESHOLDS.search.gain
INDISTINGUISHABLE_LOG_BAYES_FACTOR = THRESHOLDS.ranking.equal
NORMAL_95 = 1.959964  # standard deviations in half a 95 % interval
TIMING = ("camera_latency", "clock_offset", "frame_drop", "exposure_blur", "rolling_shutter")
ENVIRONMENT = "environment"  # module of the catalogue that the task diagnosis calls the table
Effects = frozenset[str]
"""Names of effects that are off together."""


def module_of(effect: str) -> str:
    """The module of the task diagnosis that an effect of the catalogue belongs to."""
    if effect in TIMING:
        return "timing"
    module = catalogue()[effect]["module"]
    return "table" if module == ENVIRONMENT else module


@dataclass(frozen=True)
class Hypothesis:
    """One explanation."""

    name: str
    """As the stage calls it."""
    effects: tuple[str, ...]
    """Ids of the catalogue; several where no recording distinguishes them."""
    estimates: dict[str, ValueWithInterval]
    """Parameters with their 95 % intervals, in SI units and px."""
    patch: dict[str, float] = field(default_factory=dict)
    """Parameters as `patch.yaml` names them; empty where no simulator models the effect."""

    @property
    def module(self) -> str:
        """The module of its first effect."""
        return module_of(self.effects[0])


@dataclass(frozen=True)
class TaskFinding:
    """Something that is off."""

    hypotheses: tuple[Hypothesis, ...]
    """Explanations that the recording does not distinguish, the most probable first."""
    log_bayes_factor: float
    """Nats by which the recording is more probable with the first hypothesis than without it."""
    source: str = ""
    """The stage that found it: view, scatter, touch, force, meeting or lag."""

    @property
    def is_one_effect(self) -> bool:
        """Whether all hypotheses are the same effect of the catalogue."""
        return len({effect for one in self.hypotheses for effect in one.effects}) == 1

    @property
    def is_unrivalled(self) -> bool:
        """Whether there is one hypothesis, of one effect."""
        return len(self.hypotheses) == 1 and len(self.hypotheses[0].effects) == 1


@dataclass(frozen=True)
class HypothesisComparison:
    """What explains a few measured changes."""

    verdict: str
    """no_gap, identified, ambiguous or undetermined."""
    findings: tuple[TaskFinding, ...]
    """The effects of the best hypothesis."""
    bounds: dict[str, ValueWithInterval]
    """Every number with its 95 % interval if its effect were off too."""
    unidentifiable: tuple[str, ...]
    """Numbers whose interval the recording hardly narrows."""


def verdict_of(findings: Iterable[TaskFinding]) -> str:
    """identified where every finding has one hypothesis, else ambiguous."""
    return "identified" if all(one.is_unrivalled for one in findings) else "ambiguous"


def select_effects(effects: Iterable[str], value: Callable[[Effects], float], most: int = 2) -> Effects:
    """The effects of the best hypothesis, `most` at most, each of which raises `value` (nats) enough.

    All pairs are tried first, since either of two effects may look like nothing without the other.
    """
    names = tuple(effects)
    best = max((frozenset(some) for size in range(3) for some in combinations(names, size)), key=value)
    while best and len(best) < most:
        more = max((best | {name} for name in names if name not in best), key=value, default=best)
        if value(more) - value(best) < MIN_LOG_BAYES_FACTOR:
            break
        best = more
    while best:
        fewer = max((best - {name} for name in best), key=value)
        if value(best) - value(fewer) >= MIN_LOG_BAYES_FACTOR:
            break
        best = fewer
    return best


@dataclass(frozen=True, eq=False)
class MeasuredChanges:
    """Changes against the nominal values, measured with Gaussian errors. Each has a Gaussian prior about zero, so that evidence is exact."""

    names: tuple[str, ...]
    """Names of the k numbers."""
    value: np.ndarray
    """Measured changes (k,)."""
    covariance: np.ndarray
    """Covariance of the measurement (k, k)."""
    usual: np.ndarray
    """Prior standard deviations (k,) of a set-up without a gap."""
    gap: np.ndarray
    """Further standard deviations (k,) of a number whose effect is off."""
    effects: Mapping[str, tuple[str, ...]]
    """Names of the numbers of each effect."""

    def spread(self, gaps: Effects) -> np.ndarray:
        """Prior standard deviations (k,) where these effects are off."""
        free = {number for effect in gaps for number in self.effects[effect]}
        return np.array([np.hypot(u, g) if n in free else u for n, u, g in zip(self.names, self.usual, self.gap)])

    def hypothesis_value(self, gaps: Effects) -> float:
        """Nats: log evidence less the log prior odds of the effects."""
        total = self.covariance + np.diag(self.spread(gaps) ** 2)
        evidence = float(multivariate_normal(np.zeros(len(self.value)), total).logpdf(self.value))
        return evidence - len(gaps) * np.log(N_EQUALLY_LIKELY_CANDIDATES)

    def posterior(self, gaps: Effects) -> tuple[np.ndarray, np.ndarray]:
        """Mean (k,) and standard deviation (k,) of the numbers where these effects are off."""
        before = np.diag(self.spread(gaps) ** 2)
        gain = before @ np.linalg.inv(before + self.covariance)
        return gain @ self.value, np.sqrt(np.maximum(np.diag(before - gain @ before), 0.0))

    def estimates(self, gaps: Effects, effect: str) -> dict[str, ValueWithInterval]:
        """Numbers of an effect with their 95 % intervals where these effects are off."""
        mean, deviation = self.posterior(gaps)
        rows = [self.names.index(number) for number in self.effects[effect]]
        return {
            self.names[k]: ValueWithInterval(
                float(mean[k]), float(mean[k] - NORMAL_95 * deviation[k]), float(mean[k] + NORMAL_95 * deviation[k])
            )
            for k in rows
        }


def compare_hypotheses(measured: MeasuredChanges) -> HypothesisComparison:
    """The best hypothesis of up to two effects, and its rivals."""
    every = [frozenset(some) for size in range(3) for some in combinations(measured.effects, size)]
    value = {gaps: measured.hypothesis_value(gaps) for gaps in every}
    best = select_effects(measured.effects, value.__getitem__)
    findings = tuple(_finding(measured, value, best, effect) for effect in sorted(best))
    bounds = {n: s for effect in measured.effects for n, s in measured.estimates(best | {effect}, effect).items()}
    wide = {n: NORMAL_95 * THRESHOLDS.hypotheses.narrowed * g for n, g in zip(measured.names, measured.gap)}
    found = {number for effect in best for number in measured.effects[effect]}
    unidentifiable = tuple(
        n for n, v in bounds.items() if (v.high - v.low) / 2 > wide[n] and (n not in found or v.low <= 0 <= v.high)
    )
    if findings:
        verdict = verdict_of(findings)
    else:
        verdict = "undetermined" if len(unidentifiable) == len(measured.names) else "no_gap"
    return HypothesisComparison(verdict, findings, bounds, unidentifiable)


def _finding(measured: MeasuredChanges, value: Mapping[Effects, float], best: Effects, effect: str) -> TaskFinding:
    """An effect of the best hypothesis, with those that explain as well in its place."""
    rest = best - {effect}
    near = [
        n
        for n in value
        if len(n) == len(best)
        and rest <= n
        and effect not in n
        and value[best] - value[n] < INDISTINGUISHABLE_LOG_BAYES_FACTOR
    ]
    estimates = {effect: measured.estimates(best, effect)}
    estimates |= {other: measured.estimates(n, other) for n in near for other in n - rest}
    return TaskFinding(
        tuple(Hypothesis(name, (name,), own) for name, own in estimates.items()), value[best] - value[rest]
    )
