"""Pushes of one set-up beside the model: what they have in common, what varies from run to run, and how well all is predicted.

The numbers of a run are those of its set-up plus a deviation of its own: friction is another by 10 to 20 % every time (Yu et al.,
IROS 2016). Deviations have Student's distribution, whose scale comes from the runs and from what is usual: with five runs it is
hardly known, and a run that lies outside by four standard deviations is no miracle. Evidence is Laplace's approximation of the
density of all runs, integrated over their numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.special import gammaln

from sim2real.task.limit_surface import CHANNELS, Pushed, residuals
from sim2real.task.push_parameters import PARAMETERS, SPREADS, from_vector, to_vector
from sim2real.task.pushing import Windows
from sim2real.thresholds import THRESHOLDS

FIT = THRESHOLDS.push_fit
LOG_2PI = float(np.log(2 * np.pi))
LEVELS = np.array([p.is_log for p in PARAMETERS])  # friction is another every time; a table is not
STEP = 1e-3  # of a parameter's scale, for differences


@dataclass(frozen=True, eq=False)
class Setup:
    """What is known of a set-up: mean (d,) and covariance (d, d) of what its runs have in common.

    spread (d,): scale of a run's own deviation, Student's with `freedom` degrees. noise (5,): of a window in each channel, alone;
    correlated (5,): factor of its standard deviation by which windows one after the other say the same.
    """

    mean: np.ndarray
    covariance: np.ndarray
    spread: np.ndarray
    freedom: float
    noise: np.ndarray
    correlated: np.ndarray

    @property
    def pushed(self) -> Pushed:
        """The numbers that its runs have in common."""
        return from_vector(self.mean)


@dataclass(frozen=True, eq=False)
class Fit:
    """Runs beside a set-up. common (d,), change (d,) and deviation (r, d): most probable; evidence: nats.

    covariance: of (common, change's free numbers, deviations), one after the other. left: (w, 5) of each run.
    """

    common: np.ndarray
    change: np.ndarray
    deviation: np.ndarray
    covariance: np.ndarray
    evidence: float
    left: tuple[np.ndarray, ...]


def unseen(nominal: Pushed) -> Setup:
    """A set-up of which nothing has been measured: the nominal values, and what is usual."""
    known, varies = (np.array([getattr(p, name) for p in PARAMETERS]) for name in ("known", "varies"))
    return Setup(
        to_vector(nominal), np.diag(known**2), varies, FIT.freedom, np.array(FIT.noise), np.ones(len(CHANNELS))
    )


def registered(runs: Sequence[Windows], nominal: Pushed) -> Pushed:
    """The nominal numbers with the tip registered in the object's world: by least squares, it touches the faces throughout.

    Only for frames that have never been brought together; nothing is known of the tip's place before.
    """
    usual = np.array([FIT.registration, FIT.registration, *SPREADS.marker[:1] * 2, SPREADS.half_side[0]])
    rows, right = [np.diag(1 / usual)], [np.zeros(5)]
    for run in runs:
        cos, sin = np.cos(run.yaw), np.sin(run.yaw)
        (x, y), gap = run.face.T, run.position - run.tip
        face = np.column_stack([cos * x - sin * y, sin * x + cos * y])
        rows.append(np.column_stack([face, -run.face, -np.ones(len(x))]) / FIT.noise[3])
        right.append(((face * gap).sum(axis=1) + nominal.half_side + run.tip_radius) / FIT.noise[3])
    found = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
    return replace(nominal, registration=(float(found[0]), float(found[1])))


def identify(runs: Sequence[Windows], nominal: Pushed) -> Setup:
    """The set-up of some runs. Raises ValueError for fewer than are needed to see how runs vary."""
    if len(runs) < FIT.least_runs:
        raise ValueError(f"expected {FIT.least_runs} or more pushes to identify a set-up, got {len(runs)}")
    prior = unseen(nominal)
    varies, freedom = prior.spread, FIT.freedom + len(runs) - 1
    setup = prior
    for _ in range(FIT.passes):
        found = fit(runs, Setup(prior.mean, prior.covariance, setup.spread, freedom, setup.noise, setup.correlated))
        d = len(PARAMETERS)
        own = np.diag(found.covariance)[d:].reshape(len(runs), d)
        squares = (found.deviation**2 + own).sum(axis=0)
        seen = np.sqrt((FIT.freedom * varies**2 + squares) / (FIT.freedom + len(runs)))
        spread = np.where(LEVELS, seen, varies)
        noise, correlated = _noise(found.left)
        setup = Setup(found.common, found.covariance[:d, :d], spread, freedom, noise, correlated)
    return setup


def fit(runs: Sequence[Windows], setup: Setup, changed: np.ndarray | None = None) -> Fit:
    """Runs beside a set-up; changed: numbers of the vector that may differ from it by a gap, in all runs alike."""
    changed = np.zeros(0, dtype=int) if changed is None else changed
    d, count = len(PARAMETERS), len(runs)
    root = np.linalg.cholesky(setup.covariance)
    width = np.array([p.change for p in PARAMETERS])[changed]
    scale = setup.noise * setup.correlated
    first = d + len(changed)

    def split(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        change = np.zeros(d)
        change[changed] = width * x[d:first]
        return setup.mean + root @ x[:d], change, setup.spread * x[first:].reshape(count, d)

    def off(x: np.ndarray, tails: float) -> np.ndarray:
        common, change, deviation = split(x)
        seen = np.concatenate([(e / scale).ravel() for e in _beside(common + change + deviation, runs)])
        return np.concatenate([x[:first], _student(x[first:], setup.freedom), _student(seen, tails)])

    def slopes(x: np.ndarray, tails: float) -> np.ndarray:
        common, change, deviation = split(x)
        vectors = common + change + deviation
        steps = STEP * setup.spread
        several = [run for run in runs for _ in range(d + 1)]
        moved = np.repeat(vectors, d + 1, axis=0) + np.tile(np.vstack([np.zeros(d), np.diag(steps)]), (count, 1))
        shown = [(e / scale).ravel() for e in _beside(moved, several)]
        rows = [np.eye(len(x))]
        rows[0][np.arange(first, len(x)), np.arange(first, len(x))] = _student_slope(x[first:], setup.freedom)
        for n in range(count):
            here, *there = shown[n * (d + 1) : (n + 1) * (d + 1)]
            by = (np.column_stack(there) - here[:, None]) / steps * _student_slope(here, tails)[:, None]
            row = np.zeros((len(by), len(x)))
            row[:, :d], row[:, d:first] = by @ root, by[:, changed] * width
            row[:, first + n * d : first + (n + 1) * d] = by * setup.spread
            rows.append(row)
        return np.vstack(rows)

    # With long tails alone a gap would be taken for a heap of outliers: where the search begins, tails are short.
    start = np.zeros(first + count * d)
    for tails, tolerance in ((FIT.first_tails, FIT.first_tolerance), (FIT.tails, FIT.tolerance)):
        best = least_squares(off, start, slopes, method="lm", ftol=tolerance, max_nfev=FIT.steps, args=(tails,))
        start = best.x
    bend = best.jac.T @ best.jac
    constant = gammaln((setup.freedom + 1) / 2) - gammaln(setup.freedom / 2) - 0.5 * np.log(np.pi * setup.freedom)
    evidence = (
        -best.cost
        + first * -0.5 * LOG_2PI
        + count * d * constant
        + 0.5 * len(best.x) * LOG_2PI
        - 0.5 * np.linalg.slogdet(bend)[1]
    )
    common, change, deviation = split(best.x)
    to_units = np.zeros((len(best.x), len(best.x)))
    to_units[:d, :d] = root
    own = np.r_[width, np.tile(setup.spread, count)]
    to_units[np.arange(d, len(best.x)), np.arange(d, len(best.x))] = own
    left = tuple(_beside(common + change + deviation, runs))
    covariance = to_units @ np.linalg.inv(bend) @ to_units.T
    return Fit(common, change, deviation, covariance, float(evidence), left)


def _beside(vectors: np.ndarray, runs: Sequence[Windows]) -> list[np.ndarray]:
    """Residuals (w, 5) of each run beside its own vector of (r, d), in one go."""
    lengths = [len(run.time) for run in runs]
    every = {
        f.name: np.concatenate([getattr(run, f.name) for run in runs]) for f in fields(Windows) if f.name != "name"
    }
    left = residuals(from_vector(np.repeat(vectors, lengths, axis=0)), Windows("", **every))
    return np.split(left, np.cumsum(lengths)[:-1])


def _student(z: np.ndarray, freedom: float) -> np.ndarray:
    """Numbers whose half square is minus the logarithm of Student's density of z, less its value at 0."""
    return np.sign(z) * np.sqrt((freedom + 1) * np.log1p(z * z / freedom))


def _student_slope(z: np.ndarray, freedom: float) -> np.ndarray:
    """d _student / dz."""
    z = np.where(np.abs(z) < STEP, STEP, z)
    return (freedom + 1) * z / (freedom + z * z) / _student(z, freedom)


def spread_of(z: np.ndarray) -> np.ndarray:
    """Spread (c,) of columns (n, c) that are one where they are noise as a window's is taken to be; a jump counts little."""
    return np.sqrt(np.mean(_student(z, FIT.tails) ** 2, axis=0))


def _noise(left: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Noise (5,) of a window in each channel, and factor (5,) of it for what windows one after the other have in common."""
    power = np.mean(np.concatenate(left) ** 2, axis=0)
    noise = np.maximum(np.sqrt(power), FIT.least_noise)
    shared = np.ones(len(CHANNELS))
    for lag in range(1, FIT.lags + 1):
        products = np.concatenate([e[lag:] * e[:-lag] for e in left])
        shared += 2 * np.maximum(products.mean(axis=0), 0) / noise**2
    return noise, np.sqrt(shared)
