"""Thresholds of the keypoints: when an object rests, and how its corners scatter then."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class KeypointTracking:
    """When an object rests (`sim2real.task.keypoint_track`)."""

    least: int = 30
    """Smallest number of images of a recording."""
    score: float = 0.5
    """Score from which a corner is usable: the policies' own threshold."""
    window: int = 9
    """Images to either side; the medians of both sides are compared."""
    still: float = 0.35
    """px by which the median corner may move at rest: 0.7 mm on the table."""
    surely: float = 4.5
    """Ratio to the usual difference of the medians from which the object moves."""
    resting: float = 0.25
    """Smallest share of the time at rest."""
    calm: float = 1.2
    """Largest ratio of the usual difference to a corner's noise from image to image: a memory of 0.7."""
    slow: int = 3
    """Multiple of the window in which slow motions are detected."""
    trim: float = 0.3
    """s cut off at either end of a rest: a slow start is not visible."""
    gap: float = 3.0
    """Periods between two images of one rest, at most."""
    rest: float = 0.8
    """s, shortest rest; the mean of a shorter one takes too much of the noise."""


@dataclass(frozen=True)
class KeypointScatter:
    """How keypoints scatter (`sim2real.task.keypoint_noise`)."""

    least: float = 1.5
    """s of rest in total, at least; the approach of an episode has 2.5 s."""
    finest: float = 1e-3
    """px, scatter that is rounding."""
    wide: float = 8.0
    """Multiple of the spread at which the search for gross errors starts."""
    apart: float = 2.5
    """Smallest ratio of gross errors to the spread; smaller ones are its tail."""
    noiseless: float = 0.01
    """px, spread below which images of a resting object are equal and none counts as repeated."""
    gross: float = 2.0
    """px, smallest gross error that is reported."""
    surely: float = 10.0
    """nats by which two kinds of corners must be more likely than one."""
    rounds: int = 60
    """Rounds of expectation and maximisation."""
    pairs: int = 40
    """Smallest number of pairs of successive images that determine a memory."""
    longest: float = 0.97
    """Memory beyond which a rest is too short to separate it from an offset."""
    rested: int = 8
    """Equal images after which the object rests, where nothing scatters."""
    taken: float = 0.8
    """Largest share of the power that the mean of a rest may have removed."""
