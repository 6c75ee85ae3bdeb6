"""Recordings of a simulator in lockstep have no noise: the fit keeps its priors and never meets a singular matrix."""

import numpy as np
import pytest
from arm_generator import Truth, at, record
from hypothesis import given
from hypothesis import strategies as st
from sim2real.diagnosis import diagnose
from sim2real.inference.fit import _rounding
from sim2real.inference.residual_cells import _autoregression


@given(st.floats(1e-3, 1e4), st.floats(1e-3, 10.0), st.integers(200, 5000))
def test_two_equal_columns_without_noise_are_whitened(size, prior, rows):
    column = size * np.random.default_rng(0).normal(size=rows)
    matrix, residual = np.stack([column, column], axis=1), 0.3 * column
    both = np.column_stack([matrix, residual])
    found = _autoregression(matrix, residual, np.ones(rows, bool), both.T @ both, np.array([prior, prior]))
    assert np.isfinite(found).all()


@given(st.floats(1e-3, 1e4), st.floats(1e-4, 10.0))
def test_the_smallest_variance_keeps_the_prior_in_double_precision(size, prior):
    square = 5000 * size**2
    gram = np.full((1, 1, 3, 3), square)
    floor = _rounding(gram, np.array([[prior, prior]]))
    matrix = square * prior**2 / floor[0, 0] * np.ones((2, 2)) + np.eye(2)
    assert np.linalg.cond(matrix) < 1e14
    assert np.linalg.solve(matrix, matrix @ [1.0, 1.0]).sum() == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("payload, coefficient", [(0.22, 0.4), (0.35, 0.0), (0.0, 0.8)])
def test_a_recording_without_noise_is_diagnosed(payload, coefficient):
    truth = Truth(payload=payload, viscous=at(6, coefficient), noise=0.0)
    found = diagnose([record(truth, duration=16.0)], quick=True)
    named = {finding.effect.id for finding in found.findings}
    assert ("payload" if payload else "viscous_friction") in named
