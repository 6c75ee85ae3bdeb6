"""Which experiment would settle an ambiguity, and how probably."""

import numpy as np
import pytest
from arm_generator import Truth, record
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.arm.model import panda
from sim2real.excitation.ambiguity import Ambiguity
from sim2real.excitation.planned_recordings import plan_cells, plan_log
from sim2real.excitation.power import (
    _Belief,
    _draw_log_bayes_factors,
    _log_evidence,
    predict_powers,
)
from sim2real.excitation.suite import make_experiment
from sim2real.inference.context import make_context
from sim2real.inference.regression import make_regression
from sim2real.inference.search import ModelSearch


def belief(ids, mean, spread):
    return _Belief(np.array(ids), np.array(mean, float), np.diag(np.square(spread)).astype(float), {})


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**31))
def test_evidence_is_the_density_of_the_data(seed):
    """Against the multivariate normal written out over the data themselves."""
    rng = np.random.default_rng(seed)
    columns, ids = rng.normal(size=(12, 3)), np.array([4, 7, 9])
    data = rng.normal(size=12)
    densities = []
    for b in (belief([4, 9], rng.normal(size=2), [0.5, 2.0]), belief([7], rng.normal(size=1), [1.5])):
        mine = columns[:, np.searchsorted(ids, b.ids)]
        covariance = np.eye(12) + mine @ b.covariance @ mine.T
        away = data - mine @ b.mean
        full = -0.5 * (away @ np.linalg.solve(covariance, away) + np.linalg.slogdet(covariance)[1])
        densities.append((full, _log_evidence(columns.T @ columns, (columns.T @ data)[None], ids, b)[0]))
    (full, own), (full_other, own_other) = densities
    assert own - own_other == pytest.approx(full - full_other, abs=1e-8)


def test_the_expected_factor_of_two_known_predictions_is_half_their_distance_squared():
    normal = np.array([[9.0, 0.0], [0.0, 4.0]])
    one, other = belief([0], [1.0], [1e-6]), belief([1], [2.0], [1e-6])
    factors = _draw_log_bayes_factors(normal, np.array([0, 1]), one, other)
    assert factors.mean() == pytest.approx(0.5 * (9 * 1 + 4 * 4), rel=0.15)


def test_the_same_prediction_is_never_told_apart():
    normal = np.full((2, 2), 25.0)  # the same column twice
    factors = _draw_log_bayes_factors(normal, np.array([0, 1]), belief([0], [1.0], [0.1]), belief([1], [1.0], [0.1]))
    assert np.abs(factors).max() < 1e-6


def test_a_planned_recording_is_the_motion_and_has_no_gap():
    like = record(Truth(), duration=4.0)
    segment = make_experiment("triangle_fast")
    log = plan_log(segment, panda(), like)
    q, dq, _ = segment.trajectory.sample_with_acceleration(1.0)
    row = round(1.0 / 0.002)
    assert np.allclose(log.position[row], q) and np.allclose(log.velocity[row], dq)
    context = make_context([log], panda())
    left = context.samples.torque - context.prediction.total
    assert (np.abs(left).mean(axis=0) < 0.1 * np.abs(context.samples.torque).mean(axis=0) + 0.02).all()


@pytest.fixture(scope="module")
def payload_search():
    log = record(Truth(payload=0.3), duration=20.0)
    return ModelSearch(make_regression(make_context([log], panda())))


def test_planned_cells_have_the_columns_of_the_recording(payload_search):
    design = payload_search.design
    member = next(n for n, c in enumerate(design.candidates) if c.effect.id == "payload")
    cells = plan_cells(design, ["long_second", "dwell"], [member], [1, 3])
    assert {c.joint for c in cells} == {1, 3} and all(c.test.shape[0] == 2 for c in cells)
    r2 = next(c for c in cells if c.name == "r2" and c.joint == 1)
    column = int(np.flatnonzero(r2.ids == design.candidates[member].ids[0])[0])
    assert r2.test[0, column, column] > 0  # a payload weighs on joint 2 in that posture
    assert (
        np.array([c.whiten for c in cells if c.name == "r2"])
        == np.array([c.whiten for c in design.cells if c.name == "r2" and c.joint in (1, 3)])
    ).all()


def test_longer_motions_say_more_and_a_posture_tells_payload_from_offsets(payload_search):
    design = payload_search.design
    number = {(c.effect.key, c.joint): n for n, c in enumerate(design.candidates)}
    payload = payload_search.model((number["payload", None],))
    offset = payload_search.model((number["torque_offset[unseen by the sensor]", 1],))
    question = Ambiguity((payload, offset), (("payload",), ("torque_offset",)), (1,), "arm")
    (row,) = predict_powers(payload_search, question, ["reference", "long_reference", "microstrokes"])
    short, long, still = row
    assert long.nats > short.nats > still.nats
    assert all(0 <= p.probability <= 1 for p in row)
