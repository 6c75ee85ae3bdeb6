"""Properties of filter, columns, sums, fits and schema."""

import json
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest
from arm_generator import Truth, coloured, record
from hypothesis import given, settings
from hypothesis import strategies as st

from np_description.panda import NOMINAL
from np_diagnosis.design import Sums, make_blocks
from np_diagnosis.effects import arm_effects, catalogue, joint_effects
from np_diagnosis.fit import fit
from np_diagnosis.nominal import predict
from np_diagnosis.ladder import rungs
from np_diagnosis.schema import validate
from np_diagnosis.signals import Log, sample

SCHEMA = json.loads((files("np_diagnosis") / "data" / "gap_report.schema.json").read_text())
EMPTY = {
    "schema_version": 1,
    "verdict": "no_gap",
    "where": [],
    "effects": [],
    "gap": {
        "metric": "m",
        "unit": "Nm",
        "before": 0.1,
        "after": 0.1,
        "floor": 0.1,
        "shrink": 0.0,
        "shrink_ci95": [0.0, 0.0],
    },
    "next_experiment": None,
    "data": {"bags": [], "duration_s": 1.0, "train_trajectories": 1, "test_trajectories": 1},
    "runtime_s": 0.1,
}


@pytest.fixture(scope="module")
def clean():
    log = record(Truth(noise=0.0), duration=16.0)
    samples = sample([log])
    return log, samples, predict(samples)


def test_the_nominal_arm_is_the_same_in_both_dynamics(clean):
    _, samples, prediction = clean
    residual = samples.torque - prediction.total
    reversing = np.abs(samples.velocity) < 0.1
    assert np.abs(np.where(reversing, 0, residual)).max() < 0.05
    assert (
        np.sqrt((residual**2).mean(axis=0)) < 0.15 * NOMINAL.frictionloss
    ).all()  # friction builds up there


def test_effects_are_those_of_the_catalogue_and_columns_match_parameters(clean):
    _, samples, prediction = clean
    keys = [effect.key for effect in joint_effects() + arm_effects()]
    assert len(set(keys)) == len(keys)
    for effect in joint_effects() + arm_effects():
        assert effect.id in catalogue()
        for joint in range(7):
            columns = effect.columns(samples, prediction, joint)
            assert columns.shape == (len(samples), len(effect.parameters)) and np.isfinite(columns).all()
        assert all(p.lower < 0 < p.upper and p.prior > 0 for p in effect.parameters)


def test_the_payload_column_is_the_regressor_of_a_real_payload(clean):
    _, samples, prediction = clean
    payload = next(effect for effect in arm_effects() if effect.id == "payload")
    loaded = sample([record(Truth(noise=0.0, payload=0.2), duration=16.0)])
    for joint in range(7):
        change = loaded.torque[:, joint] - samples.torque[:, joint]
        column = 0.2 * payload.columns(samples, prediction, joint)[:, 0]
        np.testing.assert_allclose(column, change, atol=0.02)


@settings(max_examples=25, deadline=None)
@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-2, 2))
def test_the_filter_keeps_straight_lines_and_their_slope(offset, slope, torque):
    time = np.cumsum(np.random.default_rng(0).uniform(0.0015, 0.0025, 1500))
    line = np.tile((offset + slope * time)[:, None], (1, 7))
    samples = sample([Log("line", time, line, line, torque * line, time, True)])
    truth = offset + slope * (samples.time + time[0])
    np.testing.assert_allclose(samples.velocity[:, 0], truth, atol=1e-9)
    np.testing.assert_allclose(samples.acceleration, slope, atol=1e-7)
    np.testing.assert_allclose(samples.torque_rate, torque * slope, atol=1e-7)


def test_blocks_cover_every_sample_once_and_keep_their_distance(clean):
    samples = clean[1]
    blocks = make_blocks(samples)
    np.testing.assert_array_equal(np.sort(np.concatenate([b.rows for b in blocks])), np.arange(len(samples)))
    for block in blocks:
        kept = np.setdiff1d(np.arange(len(samples)), block.excluded)
        assert np.abs(samples.time[kept, None] - samples.time[block.rows]).min() > 0.5


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 5))
def test_a_fit_meets_least_squares_and_its_bounds(seed, width):
    rng = np.random.default_rng(seed)
    matrix, truth = rng.normal(size=(400, width)), rng.uniform(-1, 1, width)
    whole = np.column_stack([matrix, matrix @ truth + 0.01 * rng.normal(size=400)])
    sums = Sums((whole.T @ whole)[None], np.array([400]))
    free = SimpleNamespace(
        prior=np.full(width, 10.0),
        lower=np.full(width, -np.inf),
        upper=np.full(width, np.inf),
        correlation=1.0,
    )
    columns = np.arange(width)
    np.testing.assert_allclose(
        fit(sums, columns, free).parameters[0],
        np.linalg.lstsq(matrix, whole[:, -1], rcond=None)[0],
        atol=1e-5,
    )
    boxed = SimpleNamespace(**{**vars(free), "lower": np.full(width, -0.3), "upper": np.full(width, 0.2)})
    inside = fit(sums, columns, boxed).parameters[0]
    assert (inside >= -0.3).all() and (inside <= 0.2).all()
    moved = sums.shifted(columns, truth[None])
    left = whole[:, -1] - matrix @ truth
    np.testing.assert_allclose(moved.gram[0, -1], [*(left @ matrix), left @ left], atol=1e-8)


def test_intervals_cover_under_coloured_noise():
    """Posterior intervals at the true correlation time hold the truth in about 95 of 100 cases."""
    hits, trials = 0, 200
    rng = np.random.default_rng(3)
    noise = coloured(rng, (600, trials), 0.01)
    matrix = np.repeat(rng.normal(size=(60, 1)), 10, axis=0)
    correlation = 1 + 2 * np.sum([np.exp(-0.2 * k) * (1 - k / 10) for k in range(1, 10)])
    setting = SimpleNamespace(
        prior=np.array([10.0]), lower=np.array([-9.0]), upper=np.array([9.0]), correlation=correlation
    )
    for i in range(trials):
        whole = np.column_stack([matrix, 0.4 * matrix[:, 0] + noise[:, i]])
        fitted = fit(Sums((whole.T @ whole)[None], np.array([600])), np.array([0]), setting)
        hits += abs(fitted.parameters[0, 0] - 0.4) < 1.96 * np.sqrt(fitted.covariance[0, 0, 0])
    assert 0.90 <= hits / trials <= 0.99


def test_the_ladder_is_level_for_the_law_itself_and_not_for_another(clean):
    log = clean[0]
    r0, r1 = rungs(log)
    assert (r0.name, r1.name) == ("r0", "r1")
    assert r0.rms.max() < 1e-6 and r1.rms.max() < 1e-6
    commands = log.commands
    commands.torque[:, 2] += 1.0
    try:
        r0, r1 = rungs(log)
    finally:
        commands.torque[:, 2] -= 1.0
    assert r0.rms[2] == pytest.approx(1.0, abs=1e-6) and r1.rms[2] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    "change, text",
    [
        ({"verdict": "fine"}, "verdict"),
        ({"runtime_s": "1"}, "runtime_s"),
        ({"runtime_s": float("nan")}, "finite"),
        ({"where": [{"module": "software", "component": "arm", "share": 1.5}]}, "share"),
        ({"effects": [{"effect": "payload"}]}, "component"),
        ({"schema_version": 2}, "schema_version"),
    ],
)
def test_the_schema_refuses(change, text):
    validate(EMPTY, SCHEMA)
    with pytest.raises(ValueError, match=text):
        validate(EMPTY | change, SCHEMA)
