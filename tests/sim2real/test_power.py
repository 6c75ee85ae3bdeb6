"""Which experiment would settle an ambiguity, and how probably."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arm_generator import Truth, at, record
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real.arm.model import panda
from sim2real.consequences import Consequences
from sim2real.diagnosis import explain_gap
from sim2real.effects.patch import Patch
from sim2real.excitation.ambiguity import Ambiguity, find_ambiguity, find_open_question
from sim2real.excitation.planned_recordings import plan_cells, plan_log
from sim2real.excitation.power import (
    EXPERIMENTS,
    NONE,
    UNLIKELY,
    _Belief,
    _draw_log_bayes_factors,
    _log_evidence,
    choose_next_experiment,
    predict_powers,
)
from sim2real.excitation.suite import make_experiment, make_suite
from sim2real.inference.context import make_context
from sim2real.inference.ranking import find_generalisations, is_in_column_space
from sim2real.inference.regression import make_regression
from sim2real.inference.search import ModelSearch
from sim2real.report.document import make_report, to_json
from sim2real.report.page import render
from sim2real.simulation.refit import refit_in_simulation
from sim2real.thresholds import THRESHOLDS


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
    factors = _draw_log_bayes_factors(normal, np.array([0, 1]), one, other, 0)
    assert factors.mean() == pytest.approx(0.5 * (9 * 1 + 4 * 4), rel=0.15)


def test_the_same_prediction_is_never_told_apart():
    normal = np.full((2, 2), 25.0)  # the same column twice
    factors = _draw_log_bayes_factors(normal, np.array([0, 1]), belief([0], [1.0], [0.1]), belief([1], [1.0], [0.1]), 0)
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


def test_what_are_the_same_forces_no_experiment_can_tell(uneven):
    diagnosis, log = uneven
    member = diagnosis.chosen.members[0]
    question = find_ambiguity(diagnosis.search, diagnosis.chosen, member, ())
    assert question is not None and any(
        " + ".join(names) == "coulomb_friction + torque_offset" for names in question.names
    )
    (row,) = predict_powers(diagnosis.search, question, EXPERIMENTS)
    assert max(p.probability for p in row) < 0.1
    answer = {
        "name": NONE,
        "separates": [" + ".join(n) for n in question.names],
        "component": question.component,
        "expected_sigma": 0.0,
        "probability": 0.0,
        "cannot_separate": ["coulomb_friction + torque_offset"],
        "ranked": [],
    }
    report = make_report(diagnosis, [log], 0.0, Consequences(Patch(), experiment=answer))
    assert to_json(report) and NONE in render(report, diagnosis)


def test_the_rival_is_what_explains_the_recording_and_not_a_part_of_it(uneven):
    """A constant torque alone is no rival of uneven friction; beside plain friction it is the same forces."""
    diagnosis, _ = uneven
    question = find_ambiguity(diagnosis.search, diagnosis.chosen, diagnosis.chosen.members[0], ("torque_offset",))
    assert ("torque_offset",) not in question.names and ("coulomb_friction", "torque_offset") in question.names
    assert all(p.probability < 0.1 for row in predict_powers(diagnosis.search, question, EXPERIMENTS) for p in row)


def test_an_offset_may_be_friction_with_equal_and_opposite_levels(uneven):
    """The same forces, of the drive or of the joint: neither is a special case that would leave the other one right."""
    search = uneven[0].search
    number = {(c.effect.key, c.joint): n for n, c in enumerate(search.design.candidates)}
    offset, friction = number["torque_offset[unseen by the sensor]", 0], number["asymmetric_coulomb_friction", 0]
    assert is_in_column_space(search.design, *(search.design.candidates[n] for n in (friction, offset)))
    assert find_generalisations(search, offset) == ("cable_torque",)  # whose stiffness has to be nothing for this
    assert find_generalisations(search, number["coulomb_friction", 0]) == (
        "asymmetric_coulomb_friction",
        "friction_curve",
    )


@pytest.mark.slow
def test_an_offset_is_named_with_the_friction_that_it_may_be():
    diagnosis = explain_gap([record(Truth(offset=at(1, 0.3)))])
    (finding,) = [f for f in diagnosis.findings if f.is_chosen]
    assert finding.effect.id == "torque_offset" and finding.competing_effects == ("asymmetric_coulomb_friction",)
    assert diagnosis.verdict == "ambiguous"
    answer = choose_next_experiment(diagnosis, find_open_question(diagnosis))
    # The friction contains the offset: motion can only make the larger model less probable, and no command is promised for that.
    assert answer["name"] in (NONE, UNLIKELY) and "command" not in answer
    assert answer["separates"] == ["torque_offset", "asymmetric_coulomb_friction"]


def test_an_ambiguity_is_answered_with_a_command_and_its_probability(stuck, monkeypatch):
    diagnosis, log = stuck
    (finding,) = [f for f in diagnosis.findings if f.is_chosen]
    # As if the recording had left it open whether it is viscous.
    monkeypatch.setattr("sim2real.excitation.ambiguity.AMBIGUITY", replace(THRESHOLDS.ambiguity, near=np.inf))
    open_ = replace(diagnosis, findings=(replace(finding, equivalent_to=("viscous_friction",)),))
    question = find_open_question(open_)
    answer = choose_next_experiment(open_, question)
    forward = refit_in_simulation(open_, question[1].models[1:])
    report = make_report(open_, [log], 0.0, Consequences(Patch(), experiment=answer, refit=forward))
    page = render(report, open_)
    assert [s["effects"] for s in report["forward"]["structures"]][:2] == [
        ["coulomb_friction at panda_joint4"],
        ["viscous_friction at panda_joint4"],
    ]
    assert "Second opinion" in page and "Rival" in page
    assert answer["component"] == "panda_joint4"
    assert answer["separates"][:2] == ["coulomb_friction", "viscous_friction"]
    assert answer["probability"] > 0.9 and answer["expected_sigma"] > 3
    assert f"--only {answer['name']}" in answer["command"] and f"--only {answer['name']}" in page
    assert make_suite([answer["name"]])  # excite knows it


def test_the_page_of_another_arm_has_the_catalogues_experiment(uneven):
    diagnosis, log = uneven
    another = SimpleNamespace(context=SimpleNamespace(arm=SimpleNamespace(joints=("waist",))))
    answer = choose_next_experiment(another, (diagnosis.findings[0], None))
    report = make_report(diagnosis, [log], 0.0, Consequences(Patch(), experiment=answer))
    to_json(report)
    assert f"<b>{answer['name']}</b>" in render(report, diagnosis)


def test_without_an_ambiguity_there_is_no_experiment(loaded):
    diagnosis, _ = loaded
    (finding,) = [f for f in diagnosis.findings if f.is_chosen]
    sure = replace(diagnosis, findings=(replace(finding, probability=1.0, equivalent_to=()),))
    assert find_open_question(sure) is None and choose_next_experiment(sure, None) is None
