"""Frames of a stream that are missing or repeated, and how far its stamps jitter: what the stamps alone say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.task.streams import Stream
from sim2real.thresholds import THRESHOLDS

STREAMS = THRESHOLDS.streams


@dataclass(frozen=True)
class Frames:
    """period: s between frames; missing, repeated: shares of the frames that there should be; jitter: s, standard deviation
    of a stamp about its place; longest_gap: s; overtaken: rows that came after a later one."""

    rows: int
    period: float
    missing: float
    repeated: float
    jitter: float
    longest_gap: float
    overtaken: int

    @property
    def is_dropping(self) -> bool:
        """Whether `frame_drop` is named."""
        return self.missing + self.repeated > STREAMS.loss


def frames(stream: Stream) -> Frames:
    """What the stamps of a stream say. Rows sent twice at once are one frame: nothing is missing where they stand."""
    late = np.r_[np.inf, np.diff(stream.time)] > STREAMS.fresh * stream.period
    again = int((stream.is_repeated & late).sum())
    between = np.diff(stream.time[~stream.is_repeated])
    regular = between[(between < STREAMS.late * stream.period) & (between > STREAMS.fresh * stream.period)]
    # A repeated row stands where a frame should: it is not missing besides.
    lost = max(0, int(np.maximum(np.rint(between / stream.period) - 1, 0).sum()) - again)
    total = len(between) + 1 + lost + again
    spread = 1.4826 * float(np.median(np.abs(regular - np.median(regular)))) if regular.size else 0.0
    return Frames(
        rows=len(stream.time),
        period=stream.period,
        missing=lost / total,
        repeated=again / total,
        jitter=spread / np.sqrt(2),  # two stamps make a difference
        longest_gap=float(between.max()),
        overtaken=stream.overtaken,
    )
