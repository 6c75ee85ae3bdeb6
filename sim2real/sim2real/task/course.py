"""The orientation of a stream as a smooth function of time, piece by piece: nothing is interpolated over a gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

from sim2real.task.streams import Stream
from sim2real.thresholds import THRESHOLDS

STREAMS = THRESHOLDS.streams
DEGREE = 3


@dataclass(frozen=True, eq=False)
class Course:
    """pieces: (first s, last s, spline of the quaternion x y z w); noise: rad, standard deviation of a row about them, per
    axis; period: s between rows."""

    pieces: tuple[tuple[float, float, BSpline], ...]
    noise: float
    period: float

    @property
    def density(self) -> float:
        """rad sqrt(s), noise of the orientation however often it is sampled."""
        return self.noise * np.sqrt(self.period)

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """At times (m,) s: whether there is a course (m,), quaternion (m, 4) x y z w, angular velocity (m, 3) rad/s in the
        body's frame. Where there is none, no rotation and no velocity."""
        known = np.zeros(time.shape, bool)
        quaternion, velocity = np.tile([0.0, 0.0, 0.0, 1.0], (time.size, 1)), np.zeros((time.size, 3))
        for first, last, spline in self.pieces:
            rows = (time >= first) & (time <= last)
            value, rate = spline(time[rows]), spline(time[rows], 1)
            length = np.linalg.norm(value, axis=1, keepdims=True)
            value, rate = value / length, rate / length
            known[rows], quaternion[rows] = True, value
            vector, scalar = value[:, :3], value[:, 3:]
            velocity[rows] = 2 * (scalar * rate[:, :3] - rate[:, 3:] * vector - np.cross(vector, rate[:, :3]))
        return known, quaternion, velocity

    def speed(self, time: np.ndarray) -> np.ndarray:
        """Angular speed (m,) rad/s at times (m,) s, NaN where there is no course. It is the same in every frame."""
        known, _, velocity = self.at(time)
        return np.where(known, np.linalg.norm(velocity, axis=1), np.nan)


def course(stream: Stream) -> Course:
    """The smooth course of a stream's orientation.

    Cubic splines by least squares with a knot every so many rows, as generalised cross-validation has it: a spline through
    every row would be less noisy between rows than on them, and an offset would be drawn towards half a period.
    """
    rows = np.flatnonzero(~stream.is_repeated)
    time, quaternion = stream.time[rows], stream.quaternion[rows]
    edges = np.flatnonzero(np.diff(time) > STREAMS.gap * stream.period) + 1
    parts = [part for part in np.split(np.arange(len(rows)), edges) if len(part) >= STREAMS.piece]
    pieces, squares, freedom = [], 0.0, 0.0
    for part in parts:
        t, q = time[part], quaternion[part]
        fits = [(_fit(t, q, every), every) for every in STREAMS.knots if every * 2 <= len(t)]
        spline, left, free = min(((s, r, f) for (s, r, f), _ in fits), key=lambda fit: fit[1] / fit[2] ** 2)
        pieces.append((float(t[0]), float(t[-1]), spline))
        squares, freedom = squares + left, freedom + free
    # Half a turn is a whole one of the quaternion, and of its four numbers three are free.
    noise = 2 * np.sqrt(squares / (3 * freedom)) if freedom else np.inf
    return Course(tuple(pieces), float(noise), stream.period)


def _fit(time: np.ndarray, values: np.ndarray, every: int) -> tuple[BSpline, float, float]:
    """Spline with a knot every `every` rows; squares that it leaves, and degrees of freedom that these have."""
    knots = time[every : len(time) - every : every]
    edge = DEGREE + 1
    spline = make_lsq_spline(time, values, np.r_[[time[0]] * edge, knots, [time[-1]] * edge], k=DEGREE)
    return spline, float(((spline(time) - values) ** 2).sum()), float(len(time) - len(knots) - edge)
