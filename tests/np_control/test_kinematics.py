"""Forward kinematics, Jacobian and inverse kinematics against MuJoCo, Pinocchio and finite differences."""

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from np_common.rotations import cross, matrix_from_quaternion, matrix_from_vector, vector_from_matrix
from np_control.dynamics import build_model
from np_control.kinematics import forward_kinematics, hand_pose, jacobian, pose_distance, solve_ik
from np_description.domains import CARD
from np_description.panda import NOMINAL, TCP_FRAME
from np_description.scene import load_model

torch.set_num_threads(1)
MODEL = load_model(CARD)
DATA = mujoco.MjData(MODEL)

joints = arrays(float, 7, elements=st.floats(-3.1, 3.8)).map(
    lambda q: np.clip(q, NOMINAL.position_lower, NOMINAL.position_upper)
)
# Postures from which the hand can move in every direction: about ready, away from limits and singularities.
near_ready = arrays(float, 7, elements=st.floats(-0.4, 0.4)).map(lambda step: NOMINAL.ready + step)
shifts = arrays(float, 3, elements=st.floats(-0.03, 0.03))
turns = arrays(float, 3, elements=st.floats(-0.1, 0.1))


def place(q):
    mujoco.mj_resetDataKeyframe(MODEL, DATA, 0)
    DATA.qpos[:7] = q
    mujoco.mj_forward(MODEL, DATA)


@settings(max_examples=50)
@given(joints)
def test_the_end_effector_is_where_mujoco_puts_it(q):
    place(q)
    position, rotation = forward_kinematics(q)
    site = DATA.site(TCP_FRAME)
    np.testing.assert_allclose(position, site.xpos, atol=1e-7)
    np.testing.assert_allclose(rotation, site.xmat.reshape(3, 3), atol=1e-7)
    position, rotation = hand_pose(q)
    np.testing.assert_allclose(position, DATA.body("panda_hand").xpos, atol=1e-7)
    np.testing.assert_allclose(rotation, DATA.body("panda_hand").xmat.reshape(3, 3), atol=1e-7)


@settings(max_examples=50)
@given(joints, shifts, turns)
def test_one_configuration_is_what_it_is_as_a_row_of_many(q, shift, turn):
    """Numbers of one are dealt with one by one, arrays of many by NumPy."""
    rows = np.stack([q, NOMINAL.ready])
    for function in (forward_kinematics, hand_pose, lambda q: [jacobian(q)]):
        for one, many in zip(function(q), function(rows)):
            np.testing.assert_allclose(one, many[0], atol=1e-14)
    position, rotation = forward_kinematics(q)
    goal = position + shift, matrix_from_vector(turn) @ rotation
    many = solve_ik(rows, *(np.stack([part, part]) for part in goal))[0]
    np.testing.assert_allclose(solve_ik(q, *goal), many, atol=1e-9)
    assert (vector_from_matrix(goal[1]) == vector_from_matrix(goal[1][None])[0]).all()


@given(joints)
def test_a_turned_end_effector_is_turned_for_one_configuration_as_for_many(q):
    turned = replace(NOMINAL.frames["hand_tcp"], quaternion=np.array([0.8, 0.6, 0.0, 0.0]))
    panda = replace(NOMINAL, frames=NOMINAL.frames | {"hand_tcp": turned})
    _, expected = forward_kinematics(np.stack([q, q]), panda)
    assert pose_distance(q, forward_kinematics(q)[0], expected[0], panda)[1] < 1e-7
    goal = forward_kinematics(q, panda)
    np.testing.assert_allclose(solve_ik(q, *goal, panda=panda), q, atol=1e-9)


def test_one_rotation_is_what_it_is_as_a_row_of_many():
    vectors = np.random.default_rng(0).normal(size=(50, 3)) * 10.0 ** np.linspace(-9, 0.5, 50)[:, None]
    vectors[0] = 0.0
    for matrix, vector in zip(matrix_from_vector(vectors), vectors):
        np.testing.assert_allclose(matrix_from_vector(vector), matrix, rtol=0, atol=1e-15)
        np.testing.assert_allclose(cross(vector, vectors[7]), np.cross(vector, vectors[7]), rtol=0, atol=1e-15)


@settings(max_examples=50)
@given(joints)
def test_the_end_effector_is_where_pinocchio_puts_it(q):
    model = build_model()
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    pose = data.oMi[7]
    for name in ("link7_hand", "hand_tcp"):
        frame = NOMINAL.frames[name]
        pose = pose * pin.SE3(matrix_from_quaternion(frame.quaternion), frame.position)
    position, rotation = forward_kinematics(q)
    np.testing.assert_allclose(position, pose.translation, atol=1e-7)
    np.testing.assert_allclose(rotation, pose.rotation, atol=1e-7)


@settings(max_examples=50)
@given(joints)
def test_the_jacobian_is_mujocos(q):
    place(q)
    linear, angular = np.zeros((3, MODEL.nv)), np.zeros((3, MODEL.nv))
    mujoco.mj_jacSite(MODEL, DATA, linear, angular, MODEL.site(TCP_FRAME).id)
    np.testing.assert_allclose(jacobian(q), np.vstack([linear[:, :7], angular[:, :7]]), atol=1e-6)


@settings(max_examples=50)
@given(joints, arrays(float, 7, elements=st.floats(-1, 1)))
def test_the_jacobian_is_the_derivative_of_forward_kinematics(q, direction):
    step = 1e-6
    before, after = (forward_kinematics(q + sign * step * direction) for sign in (-1, 1))
    linear = (after[0] - before[0]) / (2 * step)
    angular = vector_from_matrix(after[1] @ before[1].T) / (2 * step)
    np.testing.assert_allclose(jacobian(q) @ direction, [*linear, *angular], atol=1e-5)


@settings(max_examples=100)
@given(near_ready, shifts, turns)
def test_inverse_kinematics_reaches_the_steps_that_policies_take(q, shift, turn):
    """One step is a residual of at most 3 cm and 0.1 rad an axis (np_policy.action, deployed limits)."""
    position, rotation = forward_kinematics(q)
    target, turned = position + shift, matrix_from_vector(turn) @ rotation
    solution = solve_ik(q, target, turned)
    distance, angle = pose_distance(solution, target, turned)
    assert distance < 1e-3 and angle < 5e-3
    assert np.abs(solution - q).max() < 1.0  # the same branch, not another posture


@settings(max_examples=50)
@given(joints, arrays(float, 3, elements=st.floats(-2, 2)), arrays(float, 3, elements=st.floats(-3, 3)))
def test_inverse_kinematics_stays_finite_and_within_limits_whatever_is_asked(q, position, turn):
    solution = solve_ik(q, position, matrix_from_vector(turn))
    assert np.isfinite(solution).all()
    assert (solution >= NOMINAL.position_lower).all() and (solution <= NOMINAL.position_upper).all()


@settings(max_examples=30)
@given(near_ready, shifts, turns)
def test_numpy_and_torch_agree_and_batches_are_independent(q, shift, turn):
    position, rotation = forward_kinematics(q)
    target, turned = position + shift, matrix_from_vector(turn) @ rotation
    batch = [torch.as_tensor(np.stack([a, a])) for a in (q, target, turned)]
    for one, many in (
        (forward_kinematics(q), forward_kinematics(batch[0])),
        ((jacobian(q),), (jacobian(batch[0]),)),
        ((solve_ik(q, target, turned),), (solve_ik(*batch),)),
    ):
        for array, tensor in zip(one, many):
            np.testing.assert_allclose(tensor.numpy(), np.stack([array, array]), atol=1e-6)
