"""The estimate of the external force, its figures and the reflex."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from np_control.dynamics import Dynamics
from np_control.external_force import STICTION_SPEED, ExternalForce, ForceObserver
from np_control.force_watch import ForceWatch, read_figures, summary
from np_control.kinematics import jacobian
from np_description.force_reflex import FORCE_REFLEX, OBSERVE, STOP
from np_description.panda import NOMINAL

PERIOD = 0.002
JOINTS = st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7).map(np.array)


@given(JOINTS, JOINTS, JOINTS, JOINTS)
def test_whatever_the_motion_the_torque_that_the_model_does_not_explain_is_external(turn, dq, ddq, external):
    q, after = NOMINAL.ready + 0.3 * turn, dq + 10 * ddq * PERIOD
    friction = NOMINAL.damping * after + NOMINAL.frictionloss * np.clip(after / STICTION_SPEED, -1, 1)
    drives = Dynamics().feedforward(q, dq, 10 * ddq) + friction - external
    share = 1 - np.exp(-PERIOD / FORCE_REFLEX.time_constant)
    np.testing.assert_allclose(ForceObserver(PERIOD).update(q, dq, after, drives).torque, share * external, atol=1e-9)


def test_a_held_arm_on_which_a_force_acts_estimates_it_after_the_filter_has_settled():
    wrench = np.array([10.0, -5.0, 20.0, 0.5, -1.0, 0.2])
    observer, still = ForceObserver(PERIOD), np.zeros(7)
    drives = -jacobian(NOMINAL.ready).T @ wrench
    for _ in range(100):
        estimate = observer.update(NOMINAL.ready, still, still, drives)
    np.testing.assert_allclose(estimate.wrench, wrench, rtol=0.03, atol=0.1)
    np.testing.assert_allclose(estimate.raw, estimate.wrench, atol=1e-6)
    observer.reset()
    none = observer.last
    assert [part.tolist() for part in (none.torque, none.wrench, none.raw)] == [[0.0] * 7, [0.0] * 6, [0.0] * 6]
    assert none.share == 0


def test_a_payload_that_the_model_does_not_know_is_external_and_a_rougher_joint_is_not():
    rough = replace(NOMINAL, frictionloss=4 * NOMINAL.frictionloss, damping=3 * NOMINAL.damping)
    dq = np.full(7, 0.2)
    drives = Dynamics().feedforward(NOMINAL.ready, dq, np.zeros(7)) + rough.damping * dq + rough.frictionloss
    assert np.abs(ForceObserver(PERIOD, rough).update(NOMINAL.ready, dq, dq, drives).torque).max() < 1e-9
    assert np.abs(ForceObserver(PERIOD).update(NOMINAL.ready, dq, dq, drives).torque).max() > 0.05


@pytest.mark.parametrize("broken", ["q", "dq", "after", "torque"])
def test_a_value_that_is_not_finite_stops_the_arm_and_leaves_nothing_in_the_filter(broken):
    still = np.zeros(7)
    values = {"q": NOMINAL.ready, "dq": still, "after": still, "torque": -jacobian(NOMINAL.ready).T @ np.full(6, 2.0)}
    observer, watch = ForceObserver(PERIOD), ForceWatch(STOP)
    assert watch.add(observer.update(*values.values()), dict) == ""
    wrong = observer.update(*(values | {broken: np.full(7, np.nan)}).values())
    assert (
        watch.add(wrong, dict) == "reflex: force: no estimate: expected finite angles, speeds and torques of the joints"
    )
    after = observer.update(*values.values())
    np.testing.assert_array_equal(after.wrench, ForceObserver(PERIOD).update(*values.values()).wrench)
    assert watch.add(after, dict) == "" and 0 < watch.figures.force_n["max"] < 10


def force(newtons, raw=None):
    wrench = np.array([0, 0, newtons, 0, 0, 0.0])
    peak = np.array([0, 0, raw or newtons, 0, 0, 0.0])
    return ExternalForce(np.zeros(7), wrench, peak, newtons / FORCE_REFLEX.force)


def watched(mode, forces):
    watch = ForceWatch(mode)
    return watch, [watch.add(force(newtons), lambda: {"finger": 1.0, "housing": newtons / 30}) for newtons in forces]


def test_stops_are_counted_at_each_crossing_and_asked_for_only_where_they_are_wanted():
    forces = [1, 30, 45, 50, 30, 41, 10, 26]
    watch, causes = watched(OBSERVE, forces)
    assert watch.figures.reflex_stops == {"40": 2, "25": 2} and not any(causes)
    _, causes = watched(STOP, forces)
    assert [bool(cause) for cause in causes] == [newtons > 40 for newtons in forces]
    assert causes[2].startswith("reflex: force: 45 N")


def test_the_figures_of_an_episode_are_those_of_its_touches_and_say_what_gave_the_peak():
    watch, _ = watched(OBSERVE, [0, 1, 10, 20, 60, 2])
    watch.add(force(2, raw=200), dict)
    figures = watch.figures
    assert figures.force_n["median"] == 20 and figures.force_n["q99"] == 60
    assert figures.force_n["max"] == 60 and figures.raw_peak_n == 200
    assert figures.body == ""  # the engine said nothing at that peak
    assert watched(OBSERVE, [10])[0].figures.body == "finger" and watched(OBSERVE, [60])[0].figures.body == "housing"
    assert read_figures(str(watch)) == figures
    watch.reset()
    assert watch.figures == ForceWatch(OBSERVE).figures
    assert (
        watched(OBSERVE, [1.23456])[0].figures.raw_peak_n
        == watched(OBSERVE, [1.23456])[0].figures.force_n["max"]
        == 1.23
    )


def test_an_episode_without_a_touch_has_a_largest_force_and_no_other():
    assert watched(OBSERVE, [1, 2])[0].figures.force_n == {"median": 0.0, "q99": 0.0, "max": 2.0}


def test_what_presses_is_asked_for_at_a_new_peak_only_and_the_first_of_two_equal_ones_counts():
    watch, asked = ForceWatch(OBSERVE), []
    for body in ("finger", "housing"):
        watch.add(force(20), lambda: asked.append(body) or {body: 20.0})
    assert asked == ["finger"] and watch.figures.body == "finger"


def test_a_summary_is_of_the_episodes_largest_forces():
    figures = [watched(OBSERVE, forces)[0].figures for forces in ([5, 20], [30, 10], [50, 4])]
    found = summary(figures)
    assert found["force_n"]["median"] == 30 and found["force_n"]["max"] == 50 and found["force_episodes"] == 3
    assert found["reflex_stops"] == {"40": 1, "25": 2} and found["peak_by"] == {"finger": 2, "housing": 1}
    assert summary([]) == {}
    assert summary([watched(OBSERVE, [12.3456])[0].figures])["force_n"] == dict.fromkeys(("median", "q99", "max"), 12.3)
    json.dumps(found)


def test_bad_modes_and_texts_are_named():
    with pytest.raises(ValueError, match="expected one of stop, observe, got ignore"):
        ForceWatch("ignore")
    with pytest.raises(ValueError, match="external force: expected its figures"):
        read_figures('{"newtons": 3}')


@given(JOINTS)
def test_the_fast_jacobian_is_that_of_the_kinematics(turn):
    q = NOMINAL.ready + turn
    np.testing.assert_allclose(Dynamics().jacobian(q), jacobian(q), atol=1e-12)
