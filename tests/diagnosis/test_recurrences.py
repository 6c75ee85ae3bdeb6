"""What is computed for all samples at once is what a loop over them gives."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from np_diagnosis.inference.cells import Block, Cell, make_cell
from np_diagnosis.recordings.signals import Log, sample
from np_diagnosis.thresholds import THRESHOLDS
from np_effects.signature import Parameter
from np_effects.stage import Stage
from np_effects.sums import first_order, recurrence
from np_effects.timing.command_delay import delayed
from np_effects.timing.packet_loss import find_held
from np_effects.torque_loop.torque_rate_limit import rate_limited

PERIOD = 0.002


def drive(seed, count=600):
    """Commands of two joints that wander, in three stretches."""
    rng = np.random.default_rng(seed)
    commanded = np.cumsum(rng.normal(size=(count, 2)), axis=0)
    starts = np.array([0, 170, 171])
    return SimpleNamespace(commanded=commanded, measured=commanded, starts=starts, period=PERIOD), rng


def stretches(d, values):
    return np.split(values, d.starts[1:])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(1e-4, 3.0))
def test_a_recurrence_is_its_loop(seed, speed):
    rng = np.random.default_rng(seed)
    decay, inflow = np.exp(-rng.exponential(speed, 300)), rng.normal(size=300)
    x, expected = 0.0, []
    for a, b in zip(decay, inflow):
        x = a * x + b
        expected.append(x)
    np.testing.assert_allclose(recurrence(decay, inflow), expected, rtol=1e-12, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(5e-4, 0.05))
def test_a_lag_is_its_loop(seed, lag):
    d, _ = drive(seed)
    expected = []
    for part in stretches(d, d.commanded[:, 0]):
        x = part[0]
        for value in part:
            x += (1 - np.exp(-PERIOD / lag)) * (value - x)
            expected.append(x)
    np.testing.assert_allclose(first_order(d, d.commanded[:, 0], lag), expected, atol=1e-10)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.05, 4.0))
def test_a_limited_rate_is_its_loop(seed, step):
    d, _ = drive(seed)
    expected = []
    for part in stretches(d, d.commanded[:, 0]):
        last = part[0]
        for value in part:
            last = min(max(value, last - step), last + step)
            expected.append(last)
    np.testing.assert_allclose(rate_limited(d, d.commanded[:, 0], step / PERIOD), expected, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.02))
def test_a_delay_is_interpolation(seed, delay):
    d, _ = drive(seed)
    parts = [
        np.interp(np.arange(len(p)) - delay / PERIOD, np.arange(len(p)), p) for p in stretches(d, d.commanded[:, 0])
    ]
    np.testing.assert_allclose(delayed(d, d.commanded[:, 0], delay), np.concatenate(parts), atol=1e-9)


def test_periods_in_which_the_last_command_was_held_are_found():
    d, rng = drive(5, 6000)
    lost = rng.random(6000) < 0.05
    lost[d.starts] = False
    row = np.maximum.accumulate(np.where(lost, 0, np.arange(6000)))
    d.measured = d.commanded[row] + 0.02 * rng.normal(size=(6000, 2))
    held, share, _ = find_held(d)
    tellable = lost & (np.abs(d.commanded[row] - d.commanded).max(axis=1) > 0.2)
    assert held[tellable].all() and not held[~lost].any()
    assert share == pytest.approx(0.05, abs=0.01)


def test_the_projector_filters_what_it_interpolates():
    time = np.arange(1500) * PERIOD
    wave = np.column_stack([np.sin(3 * time), np.cos(5 * time)])
    samples = sample([Log("wave", time, wave, wave, wave, time, True)])
    late = time + PERIOD / 2
    projected = samples.projector(np.zeros(1500, int), late) @ np.sin(3 * late)
    np.testing.assert_allclose(projected, samples.position[:, 0], atol=1e-5)


def make(seed, count=900):
    """A cell with gaps in its rows, three blocks, and what a loop over its blocks says of it."""
    rng = np.random.default_rng(seed)
    time, trajectory = np.arange(count) * 0.01, np.zeros(count, int)
    rows = rng.random(count) > 0.05
    matrix, residual = rng.normal(size=(count, 3)), rng.normal(size=count)
    blocks = tuple(Block(0, 3.0 * b, 3.0 * (b + 1)) for b in range(3))
    stages = SimpleNamespace(
        times=lambda s: (trajectory, time), rows=lambda s, j, at_reversal: rows, residual=lambda s, j: residual
    )
    whiten = np.array([0.4, -0.2])
    parameters = [Parameter("p", "1", -9.0, 9.0, 1.0)] * 3
    cell = make_cell(stages, Stage.DRIVE, 0, np.arange(3), matrix, blocks, parameters, whiten)
    whole = np.column_stack([matrix, residual])
    white = whole[2:] - 0.4 * whole[1:-1] + 0.2 * whole[:-2]
    kept = rows[2:] & rows[1:-1] & rows[:-2]
    return cell, blocks, time[2:], white, kept


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_sums_of_blocks_are_those_of_their_rows(seed):
    cell, blocks, time, white, kept = make(seed)
    assert isinstance(cell, Cell)
    for b, block in enumerate(blocks):
        inside = kept & (time >= block.start) & (time < block.end)
        near = kept & (time >= block.start - THRESHOLDS.blocks.gap) & (time < block.end + THRESHOLDS.blocks.gap)
        np.testing.assert_allclose(cell.test[b], white[inside].T @ white[inside], atol=1e-9)
        np.testing.assert_allclose(cell.held[b], white[near].T @ white[near], atol=1e-9)
        assert (cell.test_rows[b], cell.held_rows[b]) == (inside.sum(), near.sum())
    columns = np.array([0, 2])
    train, test = cell.parts(columns)
    order = [3, 0, 2]
    np.testing.assert_allclose(test, cell.test[:, order][:, :, order])
    np.testing.assert_allclose(train, cell.train[:, order][:, :, order], atol=1e-9)
