"""Two streams of one rigid body, beside each other in continuous time: offset and drift of their stamps.

What is compared is the turn from a pose to the one half a second later. It does not depend on the frames in which the two
streams are given, except for the rotation between their bodies (hand and eye), which is fitted with the offset. Errors of
a pose that change slowly, as those of a lens, drop out of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from sim2real.task.course import Course
from sim2real.task.streams import Stream
from sim2real.thresholds import THRESHOLDS

CLOCK = THRESHOLDS.clock
OFFSET, DRIFT, HAND = 0, 1, slice(2, 5)  # columns: s, s/s, rad
RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class Alignment:
    """What a fit found. offset: s by which the measured stream's stamps are late against the course, at the middle of the
    measured stream; drift: s more a second; their standard errors (2,) and degrees of freedom (2,). hand: rotation from the
    body of the course to that of the measured stream. is_inverse: whether the measured poses are those of the surroundings in
    the body's frame. share: of the squares of turns that the two have in common. density (p,): log
    probability of each pair's turn, NaN for pairs outside the course; time (p,) s: middle of each."""

    offset: float
    drift: float
    errors: np.ndarray
    freedom: np.ndarray
    hand: Rotation
    is_inverse: bool
    share: float
    density: np.ndarray
    time: np.ndarray

    def half_widths(self, confidence: float = 0.95) -> np.ndarray:
        """Half widths (2,) of the intervals of offset (s) and drift (s/s)."""
        return student.ppf(0.5 + confidence / 2, self.freedom) * self.errors


def pairs(time: np.ndarray, span: float) -> tuple[np.ndarray, np.ndarray]:
    """First and last row (p,) of every pair of rows that are about `span` s apart; time (n,) s increases."""
    last = np.clip(np.searchsorted(time, time + span), 1, len(time) - 1)
    last -= (time + span - time[last - 1]) < (time[last] - time - span)
    fits = np.abs(time[last] - time - span) <= CLOCK.span_error * span
    return np.flatnonzero(fits), last[fits]


def turn(stream: Stream, span: float = CLOCK.span) -> float:
    """Root mean square of a stream's turns within a span, rad; 0 where it has no rows so far apart."""
    first, last = pairs(stream.time, span)
    turned = _turns(Rotation.from_quat(stream.quaternion), first, last).magnitude() if first.size else np.zeros(1)
    return float(np.sqrt((turned**2).mean()))


def align(
    course: Course, measured: Stream, start: float, span: float = CLOCK.span, is_inverse: bool | None = None,
    with_drift: bool = True,
) -> Alignment | None:  # fmt: skip
    """The likeliest offset near `start` s, by Gauss and Newton with the weights of Student's t; None where too little is left.

    is_inverse: None asks the turns which of the two fits. The standard errors are those of the jackknife over
    blocks of motion, which neither white nor normal noise is needed for.
    """
    kept = ~measured.is_repeated
    time, rotation = measured.time[kept], Rotation.from_quat(measured.quaternion[kept])
    first, last = pairs(time, span)
    if not first.size:
        return None
    middle = (time[0] + time[-1]) / 2
    ways = {way: _turns(rotation.inv() if way else rotation, first, last) for way in (False, True)}
    offset, drift, hand = start, 0.0, None
    for _ in range(CLOCK.passes):
        known, quaternion, velocity = course.at(time - offset - drift * (time - middle))
        used = known[first] & known[last]
        if not used.any() or np.ptp(time[first[used]]) < CLOCK.block * CLOCK.blocks:
            return None
        a, b = first[used], last[used]
        expected = _turns(Rotation.from_quat(quaternion), a, b)
        if hand is None:
            hands = {way: _hand(expected.as_rotvec(), turned[used].as_rotvec()) for way, turned in ways.items()}
            if is_inverse is None:
                is_inverse = hands[True][1] > hands[False][1]
            hand = hands[is_inverse][0]
        seen = ways[is_inverse][used]
        expected = hand.inv() * expected * hand
        residual = (seen.inv() * expected).as_rotvec()
        columns = _columns(expected, hand.inv().apply(velocity), time - middle, a, b)
        if not with_drift:
            columns[:, :, DRIFT] = 0.0
        scale = _scale(np.abs(residual), (columns[:, :, OFFSET] ** 2).sum(axis=1))
        square = ((residual / scale) ** 2).sum(axis=1)
        trust = (CLOCK.freedom + 3) / (CLOCK.freedom + square)
        weight = trust[:, None] / scale**2
        normal = np.einsum("ncj,nc,nck->njk", columns, weight, columns)
        score = np.einsum("ncj,nc,nc->nj", columns, weight, residual)
        step = -np.linalg.solve(_ridged(normal.sum(axis=0)), score.sum(axis=0))
        if abs(step[OFFSET]) < CLOCK.settled:
            break
        offset, drift = offset + step[OFFSET], drift + step[DRIFT]
        hand = hand * Rotation.from_rotvec(step[HAND])
    moved = seen.as_rotvec()
    density = np.full(len(first), np.nan)
    density[used] = -(CLOCK.freedom + 3) / 2 * np.log1p(square / CLOCK.freedom) - np.log(scale).sum()
    # A residual that grows also loses weight, so that the likelihood is less curved than the equations above.
    curved = normal - 2 / (CLOCK.freedom + 3) * score[:, :, None] * score[:, None, :]
    errors, freedom = _jackknife(curved, score, (time[a] + time[b]) / 2)
    return Alignment(
        float(offset),
        float(drift),
        errors,
        freedom,
        hand,
        is_inverse,
        share=float(1 - (weight * residual**2).sum() / (weight * moved**2).sum()),
        density=density,
        time=(time[first] + time[last]) / 2,
    )


def _turns(rotation: Rotation, first: np.ndarray, last: np.ndarray) -> Rotation:
    """The turn of each pair of rows, in the body's frame."""
    return rotation[first].inv() * rotation[last]


def _hand(expected: np.ndarray, seen: np.ndarray) -> tuple[Rotation, float]:
    """The rotation between the bodies under which turns (p, 3) rad agree best (Wahba's problem, by singular values), and how
    well they agree."""
    left, values, right = np.linalg.svd(expected.T @ seen)
    signs = np.array([1.0, 1.0, np.linalg.det(left @ right)])
    return Rotation.from_matrix(left @ np.diag(signs) @ right), float(values @ signs)


def _scale(residual: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Standard deviation (3,) of absolute residuals (p, 3) where they tell something of the offset (p,): by their median
    weighted with it, since a body that stands is seen with less noise than one that moves."""
    order = np.argsort(residual, axis=0)
    share = np.cumsum(told[order], axis=0)
    middle = (share < share[-1] / 2).sum(axis=0).clip(max=len(residual) - 1)
    return 1.4826 * np.take_along_axis(residual, order, axis=0)[middle, np.arange(3)] + 1e-12


def _columns(turn: Rotation, velocity: np.ndarray, time: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Derivatives (p, 3, 5) of the residual by offset, drift and hand. velocity (n, 3) rad/s in the measured body's frame."""
    back = turn.inv()
    begun, ended = back.apply(velocity[a]), velocity[b]
    by_drift = begun * time[a, None] - ended * time[b, None]
    by_hand = np.eye(3) - back.as_matrix()
    return np.concatenate([(begun - ended)[:, :, None], by_drift[:, :, None], by_hand], axis=2)


def _ridged(normal: np.ndarray) -> np.ndarray:
    """Normal equations (5, 5) that can be solved where a rotation about one axis leaves the hand's open."""
    diagonal = np.diag(normal)
    return normal + np.diag(RIDGE * diagonal + 1e-12 * diagonal.max() + (diagonal == 0))


def _jackknife(curved: np.ndarray, score: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard errors (2,) of offset and drift with their degrees of freedom (2,): each block of motion left out once.

    Blocks that hold no motion say nothing: the degrees of freedom are those of the information's spread over blocks.
    """
    block = ((time - time[0]) // CLOCK.block).astype(int)
    _, block = np.unique(block, return_inverse=True)
    count = int(block.max()) + 1
    curves, scores = np.zeros((count, *curved.shape[1:])), np.zeros((count, score.shape[1]))
    np.add.at(curves, block, curved)
    np.add.at(scores, block, score)
    whole, rest = curves.sum(axis=0), scores.sum(axis=0)
    moved = np.array([np.linalg.solve(_ridged(whole - c), rest - s)[:2] for c, s in zip(curves, scores)])
    errors = np.sqrt((count - 1) / count * ((moved - moved.mean(axis=0)) ** 2).sum(axis=0))
    told = np.stack([curves[:, k, k] for k in (OFFSET, DRIFT)], axis=1)
    spread = told.sum(axis=0) ** 2 / np.maximum((told**2).sum(axis=0), 1e-300)
    return errors, np.maximum(spread - 1, 1.0)
