"""Thresholds of the chain beside the arm: streams of poses, their frames and their clocks."""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.thresholds.entry import JUDGEMENT, NUMERICS, threshold


@dataclass(frozen=True)
class Streams:
    """What a stream of poses must be, and when frames are missing (chain/streams.py, chain/frames.py)."""

    rows: int = threshold(60, "rows", "fewest of a stream: two seconds at 30 Hz", JUDGEMENT)
    periods: tuple[float, float] = threshold(
        (0.0002, 0.25),
        "s",
        "median time between rows of a stream",
        "more often: stamps are not in seconds; more seldom: turns are missed",
    )
    norm: float = threshold(0.01, "1", "by which the length of a quaternion may differ from 1", JUDGEMENT)
    overtaken: float = threshold(
        0.1, "s", "by which a row may be stamped before the one before it: messages overtake one another", JUDGEMENT
    )
    gap: float = threshold(4.5, "periods", "without a row, over which nothing is interpolated", JUDGEMENT)
    fast: float = threshold(0.9, "1", "of its rows that a stream moves slower than when it is fast", JUDGEMENT)
    moving: float = threshold(
        0.1, "1", "of that speed from which a pose that stays is a frame repeated, not a standstill", JUDGEMENT
    )
    fresh: float = threshold(0.5, "periods", "after a row before which the same pose is the same row", JUDGEMENT)
    late: float = threshold(1.5, "periods", "between rows from which on one is missing", JUDGEMENT)
    loss: float = threshold(0.02, "1", "share of frames missing or repeated from which it is named", JUDGEMENT)
    knots: tuple[int, ...] = threshold(
        (2, 3, 4, 6, 8, 12, 16),
        "rows",
        "between knots of the smoothed course, of which generalised cross-validation takes one",
        "Craven and Wahba 1979",
    )
    piece: int = threshold(8, "rows", "fewest between two gaps that make a course", NUMERICS)


@dataclass(frozen=True)
class Clock:
    """Offset and drift of two streams' stamps (chain/alignment.py, chain/clock.py)."""

    within: float = threshold(1.0, "s", "to either side within which an offset is sought", JUDGEMENT)
    step: float = threshold(0.01, "s", "between the offsets at which angular speeds are compared", NUMERICS)
    overlap: float = threshold(5.0, "s", "fewest in which both streams are there", JUDGEMENT)
    peaks: int = threshold(6, "offsets", "at which speeds agree best that are followed up", NUMERICS)
    peak: float = threshold(
        0.5, "1", "of the best correlation of speeds from which an offset is followed up", JUDGEMENT
    )
    apart: float = threshold(0.02, "s", "within which two offsets are one", JUDGEMENT)
    span: float = threshold(
        0.5, "s", "between two poses whose turn is compared", "smallest errors on recordings of an arm's camera"
    )
    span_error: float = threshold(
        0.25, "1", "by which a span may be longer or shorter: rows have their times", NUMERICS
    )
    spans: tuple[float, float] = threshold(
        (0.15, 1.5), "s", "short and long span, at which a delay is the same if it is one", JUDGEMENT
    )
    freedom: float = threshold(5.0, "degrees of freedom", "of Student's t that turns are judged by", JUDGEMENT)
    passes: int = threshold(15, "passes", "of Gauss and Newton, reweighted", NUMERICS)
    settled: float = threshold(1e-6, "s", "change of the offset after which it is settled", NUMERICS)
    block: float = threshold(2.0, "s", "of motion left out at once for the standard error", JUDGEMENT)
    blocks: int = threshold(4, "blocks", "fewest for a standard error", JUDGEMENT)
    together: float = threshold(0.5, "1", "of the squares of turns that two streams of one body share", JUDGEMENT)
    noise: float = threshold(3.0, "1", "times its noise that a stream has to turn within a span", JUDGEMENT)
    sharp: float = threshold(
        0.01, "s", "half width of the interval beyond which the motion says too little", "a third of a frame at 30 Hz"
    )
    decisive: float = threshold(5.0, "nats", "by which the best offset must lead", "odds of 150 to 1")
    gain_errors: float = threshold(2.0, "standard errors", "over blocks, likewise", JUDGEMENT)
    differs: float = threshold(3.0, "standard errors", "from which thirds or paces disagree", JUDGEMENT)
    matters: float = threshold(0.003, "s", "of offset, or of disagreement, that matters", "a tenth of a frame at 30 Hz")
    sure: float = threshold(0.999, "1", "confidence at which a drift is named", JUDGEMENT)
