"""Operational-space control: decoupling, null space, closed loop."""

import mujoco
import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from np_common.rotations import matrix_from_vector
from np_control.controller import Controller, ControllerConfig
from np_control.dynamics import Dynamics
from np_control.impedance import DAMPING_RATIO_MAX, STIFFNESS_MAX, STIFFNESS_MIN
from np_control.kinematics import forward_kinematics, jacobian, pose_distance
from np_control.operational_space import SOFTEST, STIFFEST, chosen_gains, operational_space_torque
from np_control.safety import LIMITS
from np_description.domains import CARD
from np_description.panda import NOMINAL
from np_description.scene import load_model

DYNAMICS = Dynamics()
GAINS = np.array([200.0, 100.0, 400.0, 200.0, 200.0, 300.0, 1.0])
near_ready = arrays(float, 7, elements=st.floats(-0.4, 0.4)).map(lambda step: NOMINAL.ready + step)
shifts = arrays(float, 3, elements=st.floats(-0.05, 0.05))


@settings(max_examples=50)
@given(near_ready, shifts, near_ready)
def test_the_end_effector_accelerates_straight_to_the_target_whatever_the_posture(q, shift, posture):
    position, rotation = forward_kinematics(q)
    mass, rest = DYNAMICS.mass_matrix(q), np.zeros(7)
    torque = operational_space_torque(q, rest, position + shift, rotation, posture, GAINS, mass, rest)
    acceleration = jacobian(q) @ np.linalg.solve(mass, torque)
    np.testing.assert_allclose(acceleration[:3], GAINS[:3] * shift, atol=0.05)
    np.testing.assert_allclose(acceleration[3:], 0, atol=0.05)


@settings(max_examples=50)
@given(near_ready)
def test_at_the_target_only_coriolis_is_left(q):
    position, rotation = forward_kinematics(q)
    coriolis = np.arange(7.0)
    mass, rest = DYNAMICS.mass_matrix(q), np.zeros(7)
    torque = operational_space_torque(q, rest, position, rotation, q, GAINS, mass, coriolis)
    np.testing.assert_allclose(torque, coriolis, atol=1e-6)


def test_in_closed_loop_the_target_is_reached_and_kept():
    model = load_model(CARD)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    controller = Controller(ControllerConfig(cartesian=True))
    position, rotation = forward_kinematics(NOMINAL.ready)
    target = position + [0.04, -0.05, -0.06]
    turned = matrix_from_vector(np.array([0.05, 0.0, 0.1])) @ rotation
    for k in range(1000):
        controller.observe(k * LIMITS.period_ns, data.qpos[:7], data.qvel[:7])
        if k == 0:
            controller.set_target(0, target, turned, (STIFFNESS_MIN + STIFFNESS_MAX) / 2, np.ones(7))
        data.ctrl[:7] = controller.answer().torque
        mujoco.mj_step(model, data)
    distance, angle = pose_distance(data.qpos[:7], target, turned)
    assert distance < 0.01 and angle < 0.05  # Coulomb friction over stiffness
    assert np.abs(data.qvel[:7]).max() < 0.02


def test_a_direction_has_the_share_that_a_joint_would_have_and_the_ratio_is_the_mean():
    stiffness = STIFFNESS_MIN.copy()
    stiffness[[1, 5]] = STIFFNESS_MAX[[1, 5]]
    stiffness[6] = STIFFNESS_MAX[6]  # of a seventh joint: there is no seventh direction
    ratio = np.ones(7)
    ratio[0] = DAMPING_RATIO_MAX
    expected = [SOFTEST, STIFFEST, SOFTEST, SOFTEST, SOFTEST, STIFFEST, (6 + DAMPING_RATIO_MAX) / 7]
    np.testing.assert_allclose(chosen_gains(stiffness, ratio), expected)
    both = chosen_gains(torch.as_tensor(stiffness)[None], torch.as_tensor(ratio)[None])
    np.testing.assert_allclose(both.numpy(), [expected])
