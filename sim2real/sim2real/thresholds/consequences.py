"""Thresholds of what follows from a diagnosis: the next experiment, the patch and the refit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AmbiguityThresholds:
    """Which models leave a question open (`excitation.ambiguity`)."""

    rivals: int = 3
    """Largest number of rivals."""
    near: float = 8.0
    """nats behind the chosen model up to which another model is a rival."""


@dataclass(frozen=True)
class Power:
    """Which experiment is suggested (`excitation.power`)."""

    decisive: float = 5.0
    """nats by which the true model must lead in the end: odds of 150 to 1."""
    known: float = 3.0
    """nats of the present lead that count: one recording's held-out density is no more certain."""
    least: float = 0.1
    """Probability below which no experiment separates two models: they predict nearly the same forces."""
    worth: float = 0.05
    """Probability that a longer experiment must gain."""
    likely: float = 0.5
    """Probability from which an experiment is suggested; below, it more often leaves the question open."""
    ranked: int = 6
    """Number of experiments that are listed."""


@dataclass(frozen=True)
class Simulating:
    """Short simulations from recorded states (`simulation.multiple_shooting`)."""

    window: float = 0.6
    """s, duration of each simulation."""
    every: float = 1.5
    """s from the start of one simulation to the next."""
    settled: float = 0.1
    """s at the start of a simulation that do not count."""
    warm: float = 0.1
    """s before it in which effects with a memory are shown the recording."""
    period_tolerance: float = 1e-3
    """Largest relative difference between the periods of recordings."""
    smooth: int = 9
    """Rows over which the speed at the start is averaged."""
    sample: float = 0.01
    """s between the moments that are compared."""


@dataclass(frozen=True)
class Patching:
    """When an effect is left out of the patch (`simulation.patch_trial`)."""

    worse: float = 1.0005
    """Ratio to the nominal departure beyond which a patch does harm."""


@dataclass(frozen=True)
class Refitting:
    """The refit in the simulator (`simulation.refit`)."""

    models: int = 3
    """Largest number of refitted models: the chosen one and its nearest rivals."""
    windows_least: int = 8
    """Smallest number of windows of a recording that is refitted."""
    finest: float = 2e-6
    """rad, smallest difference of two simulators on a motion."""
    agree: float = 0.02
    """Relative difference up to which two simulators count as equal on the same law."""
