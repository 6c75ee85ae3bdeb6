"""Where the sealed test's detector finds corners: errors correlated with the image before, gross ones, smeared ones, and those behind a hand."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import ndtr

from np_blind.camera.quirks import Quirks
from np_description.camera import CAMERA

GROSS = 6.0  # px, of a corner that is somewhere else
SMEARED = 0.15  # of the way that a corner goes in an exposure: half the deviation of an even smear
STAYS = 0.95  # memory, from image to image, of what the hand hides
GOOD, DIM = 1.0, 0.4  # scores: policies require .5, and a pose for planning only .3
DIMMED = 0.5  # share of the corners that are dim in the darkest image of an exposure that hunts


class SimulatedDetector:
    """The detector of a case. noise, outliers: parameters of `keypoint_noise` and `keypoint_outliers`, empty where there is no such gap."""

    def __init__(self, quirks: Quirks, noise: Mapping[str, float], outliers: Mapping[str, float], seed: int):
        self._rng = np.random.default_rng([seed, 8])
        self._quirks, self._outliers = quirks, outliers
        self._own = _Remembered(quirks.noise, quirks.memory, self._rng)
        self._more = _Remembered(noise.get("spread", 0.0), noise.get("memory", 0.0), self._rng)
        self._beneath = _Remembered(quirks.beneath, STAYS, self._rng)
        self._lost = _Remembered(1.0, STAYS, self._rng)

    def __call__(
        self, pixels: np.ndarray, smear: np.ndarray, covered: np.ndarray, noisier: float, darkness: float
    ) -> np.ndarray:
        """u px, v px, score (8, 3) of corners at pixels (8, 2) that go by `smear` (8, 2) px in the exposure; covered (8,): behind the hand;
        noisier: times as the detector usually is; darkness: 0 to 1."""
        rng, quirks = self._rng, self._quirks
        usual = self._own.next() + quirks.white * rng.standard_normal((8, 2))
        found = pixels + noisier * usual + SMEARED * rng.standard_normal((8, 1)) * smear + self._more.next()
        found = found + covered[:, None] * self._beneath.next()
        kinds = (quirks.gross, GROSS), (self._outliers.get("share", 0.0), self._outliers.get("size", 0.0))
        for share, size in kinds:
            found = found + (rng.random((8, 1)) < share) * size * rng.standard_normal((8, 2))
        inside = ((found > -0.5) & (found < np.array([CAMERA.width, CAMERA.height]) - 0.5)).all(axis=1)
        is_lost = covered & (ndtr(self._lost.next()[:, 0]) < quirks.lost)
        score = np.where(rng.random(8) < DIMMED * darkness, DIM, GOOD)
        return np.column_stack([found, np.where(is_lost, DIM, score) * inside])


class _Remembered:
    """Noise (8, 2) of a deviation, each image keeping `memory` of the one before."""

    def __init__(self, deviation: float, memory: float, rng: np.random.Generator):
        self._deviation, self._memory, self._rng = deviation, memory, rng
        self._last = rng.standard_normal((8, 2))

    def next(self) -> np.ndarray:
        """Of the next image."""
        fresh = self._rng.standard_normal((8, 2))
        self._last = self._memory * self._last + np.sqrt(1 - self._memory**2) * fresh
        return self._deviation * self._last
