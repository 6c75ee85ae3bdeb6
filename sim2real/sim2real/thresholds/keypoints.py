"""Keypoints: when an object rests, and what its corners do then."""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.thresholds.entry import JUDGEMENT, NUMERICS, threshold


@dataclass(frozen=True)
class KeypointTracking:
    """When an object rests (`sim2real.task.keypoint_track`)."""

    least: int = threshold(30, "images", "fewer are no recording", JUDGEMENT)
    score: float = threshold(
        0.5, "1", "score from which on a corner is usable", "the policies' own (docs/reference/graph.md)"
    )
    window: int = threshold(9, "images", "to either side, of whose medians one takes the difference", NUMERICS)
    still: float = threshold(
        0.35, "px", "by which the middle corner may be elsewhere at rest: .7 mm on the table", JUDGEMENT
    )
    surely: float = threshold(4.5, "1", "times its usual difference, that medians differ by where it moves", JUDGEMENT)
    resting: float = threshold(0.25, "1", "share of the time that it rests at least", JUDGEMENT)
    calm: float = threshold(
        1.2,
        "1",
        "times a corner's change from image to image by noise, that the usual difference is at most: a memory of .7",
        JUDGEMENT,
    )
    slow: int = threshold(3, "1", "times the window, in which slow ways are looked for", JUDGEMENT)
    trim: float = threshold(
        0.3, "s", "at either end of a stretch that are passed over: a slow start is not seen", JUDGEMENT
    )
    gap: float = threshold(3.0, "periods", "between images of one stretch, at most", JUDGEMENT)
    rest: float = threshold(0.8, "s", "shorter stretches are passed over: a mean takes too much of them", JUDGEMENT)


@dataclass(frozen=True)
class KeypointScatter:
    """How keypoints scatter (`sim2real.task.keypoint_noise`)."""

    least: float = threshold(1.5, "s", "of rest in all, to tell; the approach of an episode has 2.5", JUDGEMENT)
    finest: float = threshold(1e-3, "px", "scatter below it is rounding", NUMERICS)
    wide: float = threshold(8.0, "1", "times the spread, at which gross errors are first looked for", NUMERICS)
    apart: float = threshold(2.5, "1", "times the spread that gross errors are, or they are its tail", JUDGEMENT)
    noiseless: float = threshold(
        0.01,
        "px",
        "spread below which images of a resting object are alike, and none is said to be repeated",
        JUDGEMENT,
    )
    gross: float = threshold(2.0, "px", "size from which on gross errors are named", JUDGEMENT)
    surely: float = threshold(10.0, "nats", "by which two kinds of corners must be likelier than one", JUDGEMENT)
    rounds: int = threshold(60, "rounds", "of expectation and maximisation", NUMERICS)
    pairs: int = threshold(40, "pairs", "of images one after the other, to tell a memory", JUDGEMENT)
    longest: float = threshold(
        0.97, "1", "memory beyond which a stretch is too short to tell it from an offset", JUDGEMENT
    )
    rested: int = threshold(8, "images", "alike after which, where nothing scatters, it rests", JUDGEMENT)
    taken: float = threshold(0.8, "1", "of the power that a stretch's own mean may have taken", JUDGEMENT)
