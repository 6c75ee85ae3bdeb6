"""What changed between the pushes of a reference and new ones: effects compete by the density of whole runs that no fit has seen.

A set-up identified on the reference predicts the new runs, with all that varies from run to run and all that is another when a
session begins (the tip's place, the tracked frame, the sensor's bias). An effect is a change common to the new runs; it is named
if it predicts them clearly better than its prior odds, integrated over its size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from sim2real.task.limit_surface import CHANNELS
from sim2real.task.push_fit import Fit, Setup, fit, spread_of
from sim2real.task.push_parameters import EFFECTS, NUISANCES, PARAMETERS, SPLIT_BY, numbers
from sim2real.task.pushing import Windows
from sim2real.thresholds import THRESHOLDS

CHANGE = THRESHOLDS.push_change
Effect = tuple[str, ...]
WIDTHS = np.array([p.change for p in PARAMETERS])


@dataclass(frozen=True)
class Size:
    """By how much a number changed: a factor where `is_factor`, else in SI units; low and high: 95 % interval."""

    field: str
    value: float
    low: float
    high: float
    is_factor: bool


@dataclass(frozen=True)
class Named:
    """One effect, as all ids that pushes cannot tell apart. gain: nats by which it predicts better than without it.

    rivals: other effects that could stand in its place. split_by: the experiment that would tell, "" where none is needed.
    """

    effect: Effect
    gain: float
    sizes: tuple[Size, ...]
    rivals: tuple[Effect, ...]
    split_by: str


@dataclass(frozen=True)
class Change:
    """The answer. verdict: no_gap, gap or unexplained. named: effects, strongest first. gains: nats of each effect alone.

    misfit: by channel, what is left of the new runs over the noise of the reference. strained: nuisances that would have to be
    farther off than they ever are. Either one too large makes the answer unexplained.
    """

    verdict: str
    named: tuple[Named, ...]
    gains: dict[Effect, float]
    misfit: dict[str, float]
    strained: tuple[str, ...]


def what_changed(setup: Setup, runs: Sequence[Windows]) -> Change:
    """Which effects explain new runs beside a set-up. Raises ValueError without runs."""
    if not runs:
        raise ValueError("expected new pushes to compare, got none")
    tried: dict[frozenset[Effect], Fit] = {}

    def model(effects: frozenset[Effect]) -> Fit:
        if effects not in tried:
            tried[effects] = fit(runs, setup, _numbers(effects))
        return tried[effects]

    def value(effects: frozenset[Effect]) -> float:
        return model(effects).evidence - len(effects) * np.log(CHANGE.prior)

    nothing = frozenset()
    gains = {effect: model(frozenset([effect])).evidence - model(nothing).evidence for effect in EFFECTS}
    chosen = nothing
    while len(chosen) < CHANGE.most:
        best = max((chosen | {effect} for effect in EFFECTS if effect not in chosen), key=value)
        if value(best) - value(chosen) < CHANGE.gain:
            break
        chosen = best
    found = model(chosen)
    misfit = spread_of(np.concatenate(found.left) / setup.noise)
    named = []
    for effect in chosen:
        rest = chosen - {effect}
        gain = value(chosen) - value(rest)
        others = (other for other in EFFECTS if other not in chosen)
        rivals = tuple(other for other in others if value(chosen) - value(rest | {other}) < CHANGE.equal)
        named.append(Named(effect, gain, _sizes(found, setup, chosen, effect), rivals, _split_by(effect, rivals)))
    named.sort(key=lambda one: -one.gain)
    strained = _strained(found, setup)
    is_off = misfit.max() > CHANGE.misfit or bool(strained)
    verdict = "unexplained" if is_off else "gap" if named else "no_gap"
    return Change(verdict, tuple(named), gains, dict(zip(CHANNELS, misfit.tolist())), strained)


def _strained(found: Fit, setup: Setup) -> tuple[str, ...]:
    """Nuisances that are farther from the set-up than set-up, session and run together may be."""
    usual = np.sqrt(WIDTHS**2 + np.diag(setup.covariance) + setup.spread**2)
    off = np.abs(found.common + found.change + found.deviation - setup.mean).max(axis=0) / usual
    return tuple(field for field in NUISANCES if off[numbers(field)].max() > CHANGE.strain)


def _numbers(effects: frozenset[Effect]) -> np.ndarray:
    """Numbers of the vector that are free: those of the effects, and of nuisances of a session."""
    return np.sort(np.concatenate([numbers(field) for field in (*(EFFECTS[e] for e in effects), *NUISANCES)]))


def _sizes(found: Fit, setup: Setup, chosen: frozenset[Effect], effect: Effect) -> tuple[Size, ...]:
    """What an effect changed, with intervals that hold the set-up's own uncertainty and what varies from run to run."""
    free, sizes = _numbers(chosen), []
    for n in numbers(EFFECTS[effect]):
        place = len(PARAMETERS) + int(np.flatnonzero(free == n)[0])
        half = float(student.ppf(0.975, setup.freedom) * np.sqrt(found.covariance[place, place]))
        ends = np.array([found.change[n], found.change[n] - half, found.change[n] + half])
        is_factor = PARAMETERS[n].is_log
        value, low, high = (np.exp(ends) if is_factor else ends).tolist()
        sizes.append(Size(PARAMETERS[n].field, value, low, high, is_factor))
    return tuple(sizes)


def _split_by(effect: Effect, rivals: tuple[Effect, ...]) -> str:
    """The experiment that tells an effect from those that explain as well."""
    ids = {i for one in (effect, *rivals) for i in one}
    fitting = [text for members, text in SPLIT_BY.items() if len(ids & set(members)) > 1]
    return "; ".join(fitting)
