"""What is computed for all samples at once is what a loop over them gives."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.effects import ARM_EFFECTS
from sim2real.effects.arm_effects import ArmEffects
from sim2real.effects.limits import excludes_gravity, find_reference_limit, limit_column
from sim2real.effects.patch import Patch, PatchEffect
from sim2real.effects.recurrences import first_order_lag, linear_recurrence, mean_lagged_torque, play_operator
from sim2real.effects.regressor import Parameter
from sim2real.effects.stage import Stage
from sim2real.effects.timing.command_delay import delay_commands
from sim2real.effects.timing.packet_loss import find_lost_packets
from sim2real.effects.torque_loop.torque_rate_limit import limit_rate, ramp_torque
from sim2real.effects.torque_loop.torque_saturation import saturate
from sim2real.inference.residual_cells import ResidualCell, TimeBlock, make_cell
from sim2real.recordings.signals import Log, sample_logs
from sim2real.thresholds import THRESHOLDS

from np_description.panda import NOMINAL

PERIOD = 0.002


def drive(seed, count=600):
    """Commands of two joints that wander, in three stretches."""
    rng = np.random.default_rng(seed)
    commanded = np.cumsum(rng.normal(size=(count, 2)), axis=0)
    starts = np.array([0, 170, 171])
    known = {
        "commanded": commanded,
        "measured": commanded,
        "arrived": commanded,
        "starts": starts,
        "period": PERIOD,
        "late": 0.0,
    }
    return SimpleNamespace(**known), rng


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
    np.testing.assert_allclose(linear_recurrence(decay, inflow), expected, rtol=1e-12, atol=1e-12)


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
    np.testing.assert_allclose(first_order_lag(d, d.commanded[:, 0], lag), expected, atol=1e-10)


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
    np.testing.assert_allclose(limit_rate(d, d.commanded[:, 0], step / PERIOD), expected, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.3, 4.0), st.floats(-40.0, 40.0))
def test_a_limited_rate_begins_where_the_drive_was(seed, step, behind):
    """Whatever was given before a recording began: it is known by the first torque measured."""
    d, _ = drive(seed)
    expected, first = [], []
    for part in stretches(d, d.commanded[:, 0]):
        last = part[0] + behind if abs(behind) > step else part[0]
        first.append(last)
        expected.append(last)
        for value in part[1:]:
            last = min(max(value, last - step), last + step)
            expected.append(last)
    measured = d.commanded[:, 0].copy()
    measured[d.starts] = first
    np.testing.assert_allclose(limit_rate(d, d.commanded[:, 0], step / PERIOD, measured), expected, atol=1e-9)


FINE = 400  # steps of a period


def through(d, step):
    """Mean over each period (n,) of a drive's torque, `step(torque, command, s)` by fine steps; anew in each stretch."""
    means = []
    for part in stretches(d, d.commanded[:, 0]):
        x = part[0]
        for value in part:
            path = []
            for _ in range(FINE):
                x = step(x, value, PERIOD / FINE)
                path.append(x)
            means.append(np.mean(path))
    return np.array(means)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10**6), st.floats(5e-4, 0.02))
def test_a_period_with_a_lag_is_the_mean_of_what_goes_on_in_it(seed, lag):
    d, _ = drive(seed, 200)
    expected = through(d, lambda x, command, s: x + (1 - np.exp(-s / lag)) * (command - x))
    np.testing.assert_allclose(mean_lagged_torque(d, d.commanded[:, 0], lag), expected, atol=0.02)
    assert np.abs(first_order_lag(d, d.commanded[:, 0], lag) - expected).max() > 0.05  # its end is something else


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.1, 2.0))
def test_a_period_with_a_limited_rate_is_the_mean_of_its_ramp(seed, rise):
    d, _ = drive(seed, 200)
    rate = rise / PERIOD
    expected = through(d, lambda x, command, s: min(max(command, x - rate * s), x + rate * s))
    np.testing.assert_allclose(ramp_torque(d, d.commanded[:, 0], rate), expected, atol=0.01)
    assert np.abs(limit_rate(d, d.commanded[:, 0], rate) - expected).max() > 0.03


@pytest.mark.parametrize("effect, parameters, law", [
    ("actuator_lag", {"time_constant": 0.004}, lambda d, x: mean_lagged_torque(d, x, 0.004)),
    ("torque_rate_limit", {"limit": 150.0, "gravity_apart": 1.0}, lambda d, x: ramp_torque(d, x, 150.0)),
])  # fmt: skip
def test_a_simulated_drive_has_the_law_that_recordings_are_asked_for(effect, parameters, law):
    commanded = np.cumsum(np.random.default_rng(1).normal(size=300))
    d = SimpleNamespace(starts=np.array([0]), period=PERIOD)
    arm = ArmEffects(Patch((PatchEffect(effect, "panda_joint4", parameters),)), PERIOD)
    given_ = [arm.drive(np.full(7, torque), NOMINAL.ready)[3] for torque in commanded]
    np.testing.assert_allclose(given_, law(d, commanded), atol=1e-9)


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("limited, limit", [(saturate, 6.0), (ramp_torque, 300.0)])
def test_what_a_limit_acts_on_is_asked_of_the_recording(limited, limit, apart):
    rng, time = np.random.default_rng(3), np.arange(3000) * PERIOD
    commanded = 8 * np.sin(7 * time) + 4 * np.sin(60 * time)
    gravity = 9 * np.sin(5 * time)
    d = SimpleNamespace(arrived=commanded[:, None], gravity=gravity[:, None], starts=np.array([0]), period=PERIOD)
    d.measured = d.arrived
    d.measured = d.arrived + limit_column(d, 0, limited, limit, apart)[:, None] + 0.03 * rng.normal(size=(3000, 1))
    assert (
        excludes_gravity(d, 0, limited, {False: [0.94 * limit, 1.1 * limit], True: [0.94 * limit, 1.1 * limit]})
        is apart
    )


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("limited, limit", [(saturate, 6.0), (ramp_torque, 300.0)])
def test_a_limit_that_a_drive_had_is_known_from_before(limited, limit, apart):
    rng, time = np.random.default_rng(3), np.arange(3000) * PERIOD
    commanded = 8 * np.sin(7 * time) + 4 * np.sin(60 * time)
    gravity = 9 * np.sin(5 * time)
    d = SimpleNamespace(arrived=commanded[:, None], gravity=gravity[:, None], starts=np.array([0, 1500]), period=PERIOD)
    d.measured = d.arrived + 0.03 * rng.normal(size=(3000, 1))
    tried, earlier = {False: [0.94 * limit, 1.1 * limit], True: [0.94 * limit, 1.1 * limit]}, time < 3.0

    def before():
        rest = {name: getattr(d, name)[earlier] for name in ("arrived", "gravity", "measured")}
        return SimpleNamespace(**rest, starts=np.array([0]), period=PERIOD)

    assert find_reference_limit(before(), 0, limited, tried) is None
    changed = d.measured + limit_column(d, 0, limited, limit, apart)[:, None]
    d.measured, unchanged = np.where(earlier[:, None], changed, d.measured), d.measured
    assert find_reference_limit(before(), 0, limited, tried) == (pytest.approx(limit, rel=3e-3), apart)
    d.measured = np.where(earlier[:, None], unchanged, changed)  # a limit that is new is not one that was there
    assert find_reference_limit(before(), 0, limited, tried) is None


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.02))
def test_a_delay_is_interpolation(seed, delay):
    d, _ = drive(seed)
    parts = [
        np.interp(np.arange(len(p)) - delay / PERIOD, np.arange(len(p)), p) for p in stretches(d, d.commanded[:, 0])
    ]
    np.testing.assert_allclose(delay_commands(d, d.commanded[:, 0], delay), np.concatenate(parts), atol=1e-9)


def test_periods_in_which_the_last_command_was_held_are_found():
    d, rng = drive(5, 6000)
    lost = rng.random(6000) < 0.05
    lost[d.starts] = False
    row = np.maximum.accumulate(np.where(lost, 0, np.arange(6000)))
    d.measured = d.commanded[row] + 0.02 * rng.normal(size=(6000, 2))
    found = find_lost_packets(d)
    held, (share, error) = found.held, found.share(np.ones(6000, bool))
    assert 0.001 < error < 0.01
    tellable = lost & (np.abs(d.commanded[row] - d.commanded).max(axis=1) > 0.2)
    assert held[tellable].all() and not held[~lost].any()
    assert share == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize("share_late", [0.0, 0.1, 0.2, 0.45])
def test_packets_are_lost_in_a_loop_that_is_late_as_well(share_late):
    """A loop that is late shows less of a lost packet: counted with the delay, every tenth and more was not seen."""
    d, rng = drive(6, 6000)
    d.commanded = 0.3 * d.commanded
    lost = rng.random(6000) < 0.05
    lost[d.starts] = False
    force = d.commanded[np.maximum.accumulate(np.where(lost, 0, np.arange(6000)))]

    def late(values):
        return np.column_stack([delay_commands(d, column, share_late * PERIOD) for column in values.T])

    d.late, d.arrived = share_late * PERIOD, late(d.commanded)
    d.measured = late(force) + 0.02 * rng.normal(size=(6000, 2))
    found = find_lost_packets(d)
    held, (share, error) = found.held, found.share(np.ones(6000, bool))
    assert share == pytest.approx(lost.mean(), rel=0.08) and held[~lost].mean() < 2e-3
    ((effect,),) = [
        ARM_EFFECTS["packet_loss"].regressors(SimpleNamespace(drive=d, held=held, held_share=share, held_error=error))
    ]
    column = effect.columns[Stage.DRIVE](SimpleNamespace(drive=d, held=held), 0)[:, 0]
    residual = d.measured[:, 0] - d.arrived[:, 0]
    assert column @ residual / (column @ column) == pytest.approx(lost.mean(), rel=0.05)


def test_the_projector_filters_what_it_interpolates():
    time = np.arange(1500) * PERIOD
    wave = np.column_stack([np.sin(3 * time), np.cos(5 * time)])
    samples = sample_logs([Log("wave", time, wave, wave, wave, time, True)])
    late = time + PERIOD / 2
    projected = samples.projector(np.zeros(1500, int), late) @ np.sin(3 * late)
    np.testing.assert_allclose(projected, samples.position[:, 0], atol=1e-5)


def make(seed, count=900):
    """A cell with gaps in its rows, three blocks, and what a loop over its blocks says of it."""
    rng = np.random.default_rng(seed)
    time, trajectory = np.arange(count) * 0.01, np.zeros(count, int)
    rows = rng.random(count) > 0.05
    matrix, residual = rng.normal(size=(count, 3)), rng.normal(size=count)
    blocks = tuple(TimeBlock(0, 3.0 * b, 3.0 * (b + 1)) for b in range(3))
    stages = SimpleNamespace(
        times=lambda s: (trajectory, time),
        rows=lambda s, j, at_reversal: rows,
        residual=lambda s, j: residual,
        project_out_reference=lambda s, j, rows, matrix, residual, at_reversal: (matrix, residual),
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
    assert isinstance(cell, ResidualCell)
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


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 3.0), st.booleans())
def test_a_play_is_its_loop_to_the_last_bit(seed, reach, stands):
    """In one column or several, and where the middle never leaves its play."""
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=(200, 2)).cumsum(axis=0) * (1e-3 if stands else 1.0)
    last, expected = middle[0], []
    for low, high in zip(middle - reach, middle + reach):
        last = np.minimum(np.maximum(last, low), high)
        expected.append(last)
    assert np.array_equal(play_operator(middle, reach), expected)
    assert np.array_equal(play_operator(middle[:, 0], reach), np.array(expected)[:, 0])
