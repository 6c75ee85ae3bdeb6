"""Thresholds of what follows from a diagnosis: the next experiment, the patch and the refit."""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.thresholds.entry import DEVELOPMENT, JUDGEMENT, NUMERICS, threshold


@dataclass(frozen=True)
class AmbiguityThresholds:
    """Which models leave a question open (experiments/ambiguity.py)."""

    rivals: int = threshold(3, "models", "rivals at most", JUDGEMENT)
    near: float = threshold(8.0, "nats", "behind the chosen model up to which another one is a rival", JUDGEMENT)


@dataclass(frozen=True)
class Power:
    """Which experiment is suggested (experiments/power.py)."""

    decisive: float = threshold(5.0, "nats", "by which the true model must lead in the end", "odds of 150 to 1")
    draws: int = threshold(200, "draws", "of the log Bayes factor of an experiment", NUMERICS)
    known: float = threshold(
        3.0, "nats", "of lead so far that count: the held-out density of one recording is no surer", JUDGEMENT
    )
    largest_log_odds: float = threshold(30.0, "nats", "beyond which odds are certainty", NUMERICS)
    least: float = threshold(
        0.1, "1", "probability below which no experiment separates two models: nearly the same forces", JUDGEMENT
    )
    worth: float = threshold(0.05, "1", "of probability for which a longer experiment is preferred", JUDGEMENT)
    likely: float = threshold(
        0.5, "1", "probability from which an experiment is suggested", "below, it leaves the question open more often"
    )
    ranked: int = threshold(6, "experiments", "listed", JUDGEMENT)


@dataclass(frozen=True)
class Simulating:
    """Short simulations from recorded states (simulation/forward.py)."""

    window: float = threshold(0.6, "s", "that each simulation goes on", JUDGEMENT)
    every: float = threshold(1.5, "s", "from one simulation to the next", JUDGEMENT)
    settled: float = threshold(0.1, "s", "at the start of a simulation that do not count", JUDGEMENT)
    warm: float = threshold(0.1, "s", "before it, in which what has a memory is shown what was recorded", JUDGEMENT)
    period_tolerance: float = threshold(1e-3, "1", "by which the periods of recordings may differ", JUDGEMENT)
    smooth: int = threshold(9, "rows", "over which the speed at the start is averaged", JUDGEMENT)
    sample: float = threshold(0.01, "s", "between the moments that are compared", JUDGEMENT)


@dataclass(frozen=True)
class Patching:
    """When an effect is left out of the patch (simulation/patching.py)."""

    worse: float = threshold(1.0005, "1", "times the nominal departure, beyond which a patch does harm", DEVELOPMENT)


@dataclass(frozen=True)
class Refitting:
    """The second opinion (simulation/refit.py)."""

    models: int = threshold(3, "models", "refitted at most: the chosen one and its nearest rivals", JUDGEMENT)
    rounds: int = threshold(3, "rounds", "of Gauss-Newton, from the values of the torque domain", NUMERICS)
    windows: int = threshold(48, "windows", "fitted to at most, and as many held out", NUMERICS)
    windows_least: int = threshold(8, "windows", "fewest of a recording that is refitted", JUDGEMENT)
    smallest_step: float = threshold(1e-3, "of the value", "for a finite difference", NUMERICS)
    finest: float = threshold(2e-6, "rad", "to which two simulators can agree on a motion", JUDGEMENT)
    largest_shift: float = threshold(
        10.0, "half widths", "of its interval by which a parameter may move in a round", NUMERICS
    )
    agree: float = threshold(0.02, "of the value", "to which two simulators agree about the same law", DEVELOPMENT)
