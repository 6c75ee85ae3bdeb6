"""The coefficient of friction from free slides: a flat object that nothing touches is slowed down by mu g, whatever its mass.

It is the experiment that tells the friction of a table from the mass of an object, which slow pushes cannot. A block that spins as
it slides loses less speed: by the ellipsoidal limit surface (`limit_surface`) the share v / sqrt(v^2 + (r w)^2) of mu g. A table that
is tilted speeds up what slides downhill; slides in several directions tell it from friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares
from scipy.stats import t as student

from sim2real.thresholds import THRESHOLDS

SLIDING = THRESHOLDS.sliding
GRAVITY = 9.81


@dataclass(frozen=True)
class Slide:
    """One stretch of free sliding. pull (2,): acceleration in m/s^2 over gravity; against (2,): mean direction of motion times the
    share of mu g that slows it down; error: standard error of a component of `pull`; duration: s."""

    pull: tuple[float, float]
    against: tuple[float, float]
    error: float
    duration: float


@dataclass(frozen=True)
class Friction:
    """mu of a pair: mean of the surface with its 95 % interval; spread: standard deviation from slide to slide; tilt: rad, x and y."""

    mu: float
    low: float
    high: float
    spread: float
    tilt: tuple[float, float]
    slides: int


def slides(time: np.ndarray, position: np.ndarray, rotation: np.ndarray, radius: float) -> list[Slide]:
    """Free slides in a recording of an object that nothing holds.

    time (n,) s, increasing; position (n, 3) m, z up; rotation (n, 3, 3) of the object in the world; radius: m, of the limit surface.
    A slide keeps its height and its lean, and is slower at its end. Raises ValueError for shapes that do not fit or stamps that go back.
    """
    shapes = (np.shape(time), np.shape(position), np.shape(rotation))
    if shapes != ((len(time),), (len(time), 3), (len(time), 3, 3)):
        raise ValueError(f"expected times (n,), positions (n, 3) and rotations (n, 3, 3), got {shapes}")
    if not (np.isfinite(position).all() and np.isfinite(rotation).all() and (np.diff(time) > 0).all()):
        raise ValueError("expected finite poses and stamps that increase")
    period = float(np.median(np.diff(time)))
    width = max(3, round(SLIDING.smoothing / period))
    velocity = uniform_filter1d(np.gradient(position, time, axis=0), width, axis=0)
    turning = uniform_filter1d(_rates(time, rotation), width, axis=0)
    speed = np.hypot(*velocity[:, :2].T)
    flat = (np.abs(velocity[:, 2]) < SLIDING.rise) & (np.hypot(*turning[:, :2].T) < SLIDING.rocking)
    edges = np.flatnonzero(np.diff(np.r_[False, flat & (speed > SLIDING.slowest), False].astype(int))).reshape(-1, 2)
    found = []
    for first, last in edges:
        first, last = first + width // 2, last - width // 2
        if last - first < 4 or time[last - 1] - time[first] < SLIDING.shortest:
            continue
        rows = slice(first, last)
        middle = time[rows] - time[rows].mean()
        powers = np.vander(middle, 3)
        fitted = np.linalg.lstsq(powers, position[rows, :2], rcond=None)[0]
        left = position[rows, :2] - powers @ fitted
        scatter = np.sqrt(np.mean(left**2)) * np.sqrt(np.linalg.inv(powers.T @ powers)[0, 0])
        share = speed[rows] / np.hypot(speed[rows], radius * turning[rows, 2])
        against = np.mean(share[:, None] * velocity[rows, :2] / speed[rows, None], axis=0)
        pull = 2 * fitted[0] / GRAVITY
        if pull @ against < 0:
            error = float(2 * scatter * np.sqrt(SLIDING.coloured) / GRAVITY)
            found.append(Slide(tuple(pull.tolist()), tuple(against.tolist()), error, float(np.ptp(middle))))
    return found


def friction(found: Sequence[Slide]) -> Friction:
    """The surface's mu from several slides. Raises ValueError for fewer than are needed.

    Slides have a mu each, about the surface's, and few of them may be no slides at all: noise is Student's.
    """
    if len(found) < SLIDING.least:
        raise ValueError(f"expected {SLIDING.least} or more slides, got {len(found)}")
    pull, against = (np.array([getattr(s, name) for s in found]) for name in ("pull", "against"))
    error = np.array([s.error for s in found])
    spread = SLIDING.spread
    for _ in range(SLIDING.passes):
        scale = np.sqrt(error**2 + spread**2)[:, None]

        def off(x: np.ndarray, scale: np.ndarray = scale) -> np.ndarray:
            here = (pull + x[0] * against - x[1:]) / scale
            z = np.r_[here.ravel(), x[1:] / SLIDING.tilt]
            return np.sign(z) * np.sqrt((SLIDING.tails + 1) * np.log1p(z * z / SLIDING.tails))

        best = least_squares(off, [0.3, 0.0, 0.0])
        along = ((pull + best.x[0] * against - best.x[1:]) * against).sum(1) / (against**2).sum(1)
        seen = 1.4826 * np.median(np.abs(along))
        spread = float(np.sqrt(max(seen**2 - np.median(error) ** 2, 0) + SLIDING.spread**2 / len(found)))
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    half = float(student.ppf(0.975, len(found) - 1) * np.sqrt(covariance[0, 0]))
    mu, x, y = best.x.tolist()
    return Friction(mu, mu - half, mu + half, spread, (x, y), len(found))


def _rates(time: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Angular velocity (n, 3) rad/s in the world, from differences of rotations (n, 3, 3)."""
    change = np.gradient(rotation, time, axis=0) @ np.swapaxes(rotation, 1, 2)
    skew = (change - np.swapaxes(change, 1, 2)) / 2
    return np.column_stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]])
