"""Scatter that goes up and down for all corners together is told from each corner's own."""

import warnings

import numpy as np
import pytest
from sim2real.task.keypoint_track import KeypointTrack
from sim2real.task.suite.noise_stationarity import noise_variation_factor

IMAGES, CORNERS = 900, 8
RESTS = [slice(0, IMAGES)]


def seen(noise: np.ndarray) -> KeypointTrack:
    """Corners that rest, with noise (n, 8, 2) px."""
    return KeypointTrack("a track", np.arange(IMAGES) / 30.0, 200.0 + noise, np.ones((IMAGES, CORNERS), bool))


def drawn() -> np.ndarray:
    return np.random.default_rng(3).normal(0.0, 0.3, (IMAGES, CORNERS, 2))


def test_corners_that_do_not_scatter_are_steady_and_nobody_is_warned():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert noise_variation_factor(seen(np.zeros((IMAGES, CORNERS, 2))), RESTS) == 1.0


def test_scatter_of_each_corner_by_itself_is_steady():
    assert noise_variation_factor(seen(drawn()), RESTS) == 1.0


def test_scatter_that_all_corners_have_more_of_together_is_not():
    swing = 1.8 ** np.sin(2 * np.pi * np.arange(IMAGES) / 150)
    assert noise_variation_factor(seen(drawn() * swing[:, None, None]), RESTS) == pytest.approx(1.5, abs=0.15)
