"""Seen corners beside the view's model: the most probable numbers, and how probable all that was seen is.

A corner's error in a place is Student's, in both coordinates together (a wrong corner is off in both); its scale is what a detector's
error is from view to view, estimated along with everything else, and what is left of the scatter from image to image. What is usual of
a number is Gaussian; a gap is Cauchy's, so that none is preferred to another for being the smaller one. The three numbers of each
place are eliminated (Schur complement), so that a step costs the same however many places there are, but for making its matrices.
Evidence is Laplace's approximation of the density of all corners, integrated over all numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize_scalar

from sim2real.task.camera.model import CameraScene, LinearisedScene, linearise
from sim2real.task.camera.parameters import COUNT
from sim2real.thresholds import THRESHOLDS

FIT = THRESHOLDS.camera_fit
MEASURED = np.repeat(THRESHOLDS.camera_spreads.measured, 3)


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior distribution of the numbers."""

    spread: np.ndarray
    """Scales (d,)."""
    gap: np.ndarray
    """Whether (d,) a number is a gap: Cauchy in place of Gaussian."""
    free: np.ndarray
    """Whether (d,) a number may differ from zero."""

    def cost(self, vector: np.ndarray) -> float:
        """Minus the log density, nats but for a constant."""
        square = (vector / self.spread) ** 2
        return float(np.where(self.gap, np.log1p(square), square / 2)[self.free].sum())

    def precision(self, vector: np.ndarray) -> np.ndarray:
        """Slope of the cost over the number, (d,): of a gap, less the farther it is."""
        far = 2 / (1 + (vector / self.spread) ** 2)
        return np.where(self.gap, far, 1.0) / self.spread**2

    @property
    def volume(self) -> float:
        """What evidence is counted from, nats: that of a number about which nothing is seen is none."""
        return float(np.log(self.spread[self.free]).sum() - 0.5 * np.log(2.0) * (self.gap & self.free).sum())


@dataclass(frozen=True, eq=False)
class CameraFit:
    """A scene beside the model."""

    vector: np.ndarray
    """Most probable numbers (d,)."""
    covariance: np.ndarray
    """Their covariance (d, d)."""
    poses: np.ndarray
    """x m, y m, yaw rad (k, 3) of the object."""
    scatter: float
    """Error px of a corner in a view."""
    evidence: float
    """Log evidence (nats), up to a constant of the scene."""
    cost: float
    """Minus the log density (nats) at the most probable numbers."""
    freedom: float
    """Coordinates seen beyond the numbers that were fitted."""
    lines: LinearisedScene
    """The model there."""
    weights: np.ndarray
    """Weights (k, 8) 1/px^2 of the corners, 0 where not usable."""

    def left(self, scene: CameraScene) -> np.ndarray:
        """Pixels (k, 8, 2) by which corners are seen off the model, NaN where not usable."""
        return np.where(scene.usable[..., None], scene.pixels - self.lines.pixels, np.nan)


def fit_scene(
    scene: CameraScene, prior: Prior, start: np.ndarray, scatter: float | None = None, first: CameraFit | None = None
) -> CameraFit:
    """The most probable numbers. start (k, 3): poses; scatter: px, None to estimate it; first: a fit to begin from."""
    held, begun = scatter is not None, first is not None
    scatter = scatter if held else first.scatter if begun else THRESHOLDS.camera_comparison.misfit
    search = _Search(scene, prior)
    vector, poses = (first.vector, first.poses) if begun else (np.zeros(COUNT), start)
    if not begun:  # with long tails alone a gap would be taken for a heap of outliers
        vector, poses = search.descend(vector, poses, scatter, FIT.first_tails)
    for _ in range(1 if held else FIT.rounds):
        vector, poses = search.descend(vector, poses, scatter, FIT.tails)
        if held:
            break
        before, scatter = scatter, search.scatter(vector, poses, scatter)
        if abs(np.log(scatter / before)) < 1e-3:
            break
    return search.summary(vector, poses, scatter)


def evaluate_at(
    scene: CameraScene, vector: np.ndarray, poses: np.ndarray, scatter: float, held: bool = False
) -> CameraFit:
    """The scene at numbers (d,) that are known, with the poses (k, 3) that fit best; held: with these poses."""
    none = np.zeros(COUNT, bool)
    search = _Search(scene, Prior(np.ones(COUNT), none, none))
    if not held:
        vector, poses = search.descend(vector, poses, scatter, FIT.tails)
    return search.summary(vector, poses, scatter)


class _Search:
    """A scene with what is known of its numbers beforehand."""

    def __init__(self, scene: CameraScene, prior: Prior) -> None:
        self.scene, self.prior, self.free = scene, prior, prior.free

    def descend(self, vector, poses, scatter: float, tails: float) -> tuple[np.ndarray, np.ndarray]:
        """Levenberg and Marquardt's steps, each with the weights that Student's density has there."""
        damping, factor = FIT.damping
        lines = linearise(self.scene, vector, poses)
        cost = self.cost(lines, vector, scatter, tails)
        for _ in range(FIT.steps):
            weights = self.weights(lines, scatter, tails)
            normal, cross, own = self.matrices(lines, vector, weights)
            down, down_own = self.slopes(lines, vector, weights)
            while True:
                step, step_own = self.solve(normal, cross, own, down, down_own, damping)
                trial, there = vector + step, poses + step_own
                ahead = linearise(self.scene, trial, there)
                better = cost - self.cost(ahead, trial, scatter, tails)
                if better >= 0 or damping > 1e6:
                    break
                damping *= factor
            if better < 0:
                break
            vector, poses, lines, cost = trial, there, ahead, cost - better
            damping = max(damping / factor, FIT.damping[0])
            if better < FIT.settled:
                break
        return vector, poses

    def squares(self, lines: LinearisedScene, scatter: float) -> tuple[np.ndarray, np.ndarray]:
        """Of each corner (k, 8): variance px^2 of a coordinate, and the square of its error over it."""
        variance = scatter**2 + self.scene.error**2
        return variance, ((self.scene.pixels - lines.pixels) ** 2).sum(axis=-1) / variance

    def cost(self, lines: LinearisedScene, vector: np.ndarray, scatter: float, tails: float) -> float:
        """Minus the log density of what is seen and of the numbers, but for constants."""
        if not lines.ahead:
            return np.inf
        variance, square = self.squares(lines, scatter)
        corners = np.log(variance) + (tails + 2) / 2 * np.log1p(square / tails)
        level = (np.log(scatter / FIT.scatter[0]) / FIT.scatter[1]) ** 2
        return float(
            corners[self.scene.usable].sum()
            + self.prior.cost(vector)
            + (((lines.off / MEASURED) ** 2).sum() + level) / 2
        )

    def weights(self, lines: LinearisedScene, scatter: float, tails: float) -> np.ndarray:
        """Of each corner (k, 8), 1/px^2: the slope of its cost over its error."""
        variance, square = self.squares(lines, scatter)
        return np.where(self.scene.usable, (tails + 2) / (tails + square) / variance, 0.0)

    def bends(self, lines: LinearisedScene, scatter: float) -> np.ndarray:
        """Of each corner (k, 8), 1/px^2: mean second derivative of its cost, less than its weight where it is far off."""
        variance, square = self.squares(lines, scatter)
        bend = (FIT.tails + 2) * FIT.tails / (FIT.tails + square) ** 2 / variance
        return np.where(self.scene.usable, bend, 0.0)

    def matrices(
        self, lines: LinearisedScene, vector: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Second derivatives by the vector (d, d), by both (k, d, 3) and by each pose (k, 3, 3)."""
        k = len(self.scene)
        root = np.sqrt(weights)[..., None, None]
        by_corner = (root * lines.by_vector).reshape(k, 16, COUNT)
        by_vector = np.concatenate([by_corner, lines.off_by_vector / MEASURED[:, None]], axis=1) * self.free
        by_pose = np.concatenate(
            [(root * lines.by_pose).reshape(k, 16, 3), lines.off_by_pose / MEASURED[:, None]], axis=1
        )
        flat = by_vector.reshape(-1, COUNT)
        transposed = np.swapaxes(by_vector, 1, 2)
        return (
            flat.T @ flat + np.diag(self.prior.precision(vector)),
            transposed @ by_pose,
            np.swapaxes(by_pose, 1, 2) @ by_pose,
        )

    def slopes(self, lines: LinearisedScene, vector: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Minus the derivatives of the cost, (d,) and (k, 3)."""
        pull = weights[..., None] * (self.scene.pixels - lines.pixels)
        held = -lines.off / MEASURED**2
        by_vector = np.einsum("kcid,kci->d", lines.by_vector, pull) + np.einsum("kid,ki->d", lines.off_by_vector, held)
        by_pose = np.einsum("kcid,kci->kd", lines.by_pose, pull) + np.einsum("kid,ki->kd", lines.off_by_pose, held)
        return by_vector * self.free - vector * self.prior.precision(vector), by_pose

    def solve(self, normal, cross, own, down, down_own, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """The step (d,) and (k, 3) of the damped equations, the poses eliminated."""
        inverse = np.linalg.inv(own + damping * own * np.eye(3))
        gone = cross @ inverse  # (k, d, 3)
        reduced = normal - np.einsum("kip,kjp->ij", gone, cross) + damping * np.diag(np.diag(normal))
        step = cho_solve(cho_factor(reduced), down - np.einsum("kip,kp->i", gone, down_own))
        return step * self.free, np.einsum("kpq,kq->kp", inverse, down_own - np.einsum("kip,i->kp", cross, step))

    def inverse(self, lines: LinearisedScene, vector: np.ndarray, bends: np.ndarray) -> tuple[np.ndarray, float, float]:
        """Inverse (d, d) of the vector's second derivatives with poses eliminated; numbers that corners fix; log determinant of all."""
        normal, cross, own = self.matrices(lines, vector, bends)
        inverse = np.linalg.inv(own)
        gone = cross @ inverse
        reduced = normal - np.einsum("kip,kjp->ij", gone, cross)
        found = np.linalg.inv(reduced)
        by_vector = lines.by_vector * self.free - np.einsum("kcip,kjp->kcij", lines.by_pose, gone)
        spent = np.einsum("kcid,de,kcie->kc", by_vector, found, by_vector, optimize=True)
        spent += np.einsum("kcip,kpq,kciq->kc", lines.by_pose, inverse, lines.by_pose, optimize=True)
        volume = np.linalg.slogdet(reduced)[1] + np.linalg.slogdet(own)[1].sum()
        return found, float((bends * spent).sum()), float(volume)

    def scatter(self, vector, poses, scatter: float) -> float:
        """px: the most probable scatter, of the numbers seen beyond those that were fitted."""
        lines = linearise(self.scene, vector, poses)
        usable = self.scene.usable
        spent = self.inverse(lines, vector, self.bends(lines, scatter))[1]
        share = spent / (2 * usable.sum())

        def off(level: float) -> float:
            variance, _ = self.squares(lines, np.exp(level))
            return self.cost(lines, vector, np.exp(level), FIT.tails) - share * np.log(variance[usable]).sum()

        return float(np.exp(minimize_scalar(off, bounds=np.log(FIT.scatters), method="bounded").x))

    def summary(self, vector, poses, scatter: float) -> CameraFit:
        """The result of a fit."""
        lines = linearise(self.scene, vector, poses)
        bends, weights = self.bends(lines, scatter), self.weights(lines, scatter, FIT.tails)
        _, spent, volume = self.inverse(lines, vector, bends)
        cost = self.cost(lines, vector, scatter, FIT.tails)
        usable = self.scene.usable
        freedom = max(2 * usable.sum() - spent, 1.0)
        # Huber's sandwich: how much corners pull, against how much that was expected of this density. A few that happen to pull little are
        # not taken to be better than Gaussian ones of that scatter.
        variance, square = self.squares(lines, scatter)
        pull = ((weights**2 * variance * square)[usable] * variance[usable]).sum() / freedom
        expected = (bends * variance)[usable].mean()
        covariance = self.inverse(lines, vector, bends * min(expected / pull, 1.0 / expected))[0]
        return CameraFit(
            vector,
            covariance * np.outer(self.free, self.free),
            poses,
            scatter,
            -cost - volume / 2 - self.prior.volume,
            cost,
            freedom,
            lines,
            weights,
        )
