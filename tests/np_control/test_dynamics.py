"""Pinocchio's model of the arm against MuJoCo's, both built from the nominal numbers."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from np_control.dynamics import Dynamics, build_model
from np_control.safety import LIMITS
from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_description.scene import load_model

DYNAMICS = Dynamics()
MODEL = load_model(CARD)
DATA = mujoco.MjData(MODEL)

positions = arrays(float, 7, elements=st.floats(-3.1, 3.8)).map(
    lambda q: np.clip(q, NOMINAL.position_lower, NOMINAL.position_upper)
)
velocities = arrays(float, 7, elements=st.floats(-2.5, 2.5))


def simulated(q, dq):
    mujoco.mj_resetDataKeyframe(MODEL, DATA, 0)
    DATA.qpos[:7], DATA.qvel[:7] = q, dq
    mujoco.mj_forward(MODEL, DATA)
    return DATA


@settings(max_examples=50)
@given(positions, velocities)
def test_coriolis_and_gravity_equal_mujocos_bias(q, dq):
    data = simulated(q, dq)
    np.testing.assert_allclose(DYNAMICS.coriolis(q, dq) + DYNAMICS.gravity(q), data.qfrc_bias[:7], atol=1e-6)
    np.testing.assert_allclose(DYNAMICS.gravity(q), data.qfrc_gravcomp[:7], atol=1e-6)


@settings(max_examples=50)
@given(positions)
def test_mass_matrix_equals_mujocos(q):
    data = simulated(q, np.zeros(7))
    expected = np.zeros((MODEL.nv, MODEL.nv))
    mujoco.mj_fullM(MODEL, data, expected)
    np.testing.assert_allclose(DYNAMICS.mass_matrix(q), expected[:7, :7], atol=1e-6)


@settings(max_examples=50)
@given(positions, velocities, velocities)
def test_feedforward_is_the_sum_of_its_terms(q, dq, ddq):
    expected = DYNAMICS.mass_matrix(q) @ ddq + DYNAMICS.coriolis(q, dq)
    np.testing.assert_allclose(DYNAMICS.feedforward(q, dq, ddq), expected, atol=1e-9)


@settings(max_examples=50)
@given(positions, velocities)
def test_coriolis_is_quadratic_in_velocity(q, dq):
    np.testing.assert_allclose(DYNAMICS.coriolis(q, 2 * dq), 4 * DYNAMICS.coriolis(q, dq), atol=1e-9)
    np.testing.assert_array_equal(DYNAMICS.coriolis(q, np.zeros(7)), np.zeros(7))


def test_open_fingers_shift_the_inertia_a_little():
    q = NOMINAL.ready
    difference = Dynamics(finger_opening=0.04).mass_matrix(q) - DYNAMICS.mass_matrix(q)
    # Two fingers of 15 g, 40 mm from the axis of joint 7.
    assert difference[6, 6] == pytest.approx(2 * 0.015 * 0.04**2, rel=1e-6)


def test_model_names_and_limits_are_the_nominal_ones():
    model = build_model()
    assert tuple(model.names[1:]) == NOMINAL.joints
    np.testing.assert_array_equal(model.lowerPositionLimit, NOMINAL.position_lower)
    np.testing.assert_array_equal(model.upperVelocityLimit, NOMINAL.velocity_limit)


@settings(max_examples=100)
@given(positions)
def test_no_joint_shows_less_inertia_than_the_guards_assume(q):
    least = 1 / np.diag(np.linalg.inv(DYNAMICS.mass_matrix(q)))
    assert (least >= LIMITS.inertia).all()
