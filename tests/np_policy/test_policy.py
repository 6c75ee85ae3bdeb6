"""The networks as the nodes use them: right meaning of the output, memory, reproducible, clear about missing weights."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from np_common.rotations import matrix_from_quaternion, six_from_matrix
from np_control.impedance import STIFFNESS_MAX, STIFFNESS_MIN
from np_control.kinematics import forward_kinematics
from np_description.domains import CARD, sample_task
from np_description.panda import FINGER_MAX, NOMINAL
from np_description.weights.contract import KEY
from np_description.weights.header import with_metadata
from np_perception.pose_estimation import project_keypoints
from np_policy.action import RESIDUAL_LIMITS_FINAL, PolicyError, decode, normalise_stiffness
from np_policy.contract import POST_CONTACT, PRE_CONTACT, PolicyContract, weights_file
from np_policy.hand_pose import POSITION_CENTRE, POSITION_RANGE
from np_policy.networks import PostContactNetwork, PreContactNetwork
from np_policy.observation import post_contact_observation, student_observation
from np_policy.policy import RETREAT_HEIGHT, PostContactPolicy, PreContactPolicy, student_output
from np_policy.weights import WeightsError, save

START, GOAL = (project_keypoints(CARD, pose) for pose in sample_task(CARD, np.random.default_rng(0)))
Q = np.concatenate([NOMINAL.ready, [0.01, 0.01]])


@pytest.fixture
def folder(tmp_path):
    torch.manual_seed(0)
    for kind, network in ((PRE_CONTACT, PreContactNetwork()), (POST_CONTACT, PostContactNetwork())):
        for parameter in network.parameters():
            torch.nn.init.normal_(parameter, std=0.1)
        save(network, weights_file(kind, CARD, tmp_path), PolicyContract.of(kind, CARD))
    return tmp_path


@pytest.fixture
def controller(folder):
    return PostContactPolicy(weights_file("post_contact", CARD, folder), CARD)


def test_the_students_output_is_a_pose_and_an_opening():
    rotation = np.diag([1.0, -1.0, -1.0])
    wanted = student_output(np.concatenate([2 * six_from_matrix(rotation), [0.5, -0.25, 0.0], [0.25]]))
    np.testing.assert_allclose(matrix_from_quaternion(wanted.pose.quaternion), rotation, atol=1e-12)
    np.testing.assert_allclose(
        wanted.pose.position, np.array(POSITION_CENTRE) + POSITION_RANGE * np.array([0.5, -0.25, 0.0])
    )
    assert wanted.opening == pytest.approx(FINGER_MAX / 4)
    assert student_output(np.concatenate([six_from_matrix(rotation), [0, 0, 0], [7.0]])).opening == FINGER_MAX


@pytest.mark.parametrize("output", [np.zeros(10), np.full(10, np.nan), np.ones(10)])
def test_an_output_without_a_rotation_is_refused(output):
    with pytest.raises(PolicyError, match="give a rotation"):
        student_output(output)


def test_the_student_gives_equal_bits_for_equal_keypoints(folder):
    first, second = (PreContactPolicy(weights_file("pre_contact", CARD, folder), CARD) for _ in range(2))
    a, b = first.propose(START, GOAL), second.propose(START, GOAL)
    assert a.pose.position.tobytes() == b.pose.position.tobytes() and a.opening == b.opening
    assert a.pose.position.tobytes() != first.propose(GOAL, START).pose.position.tobytes()


def test_targets_stay_within_the_residual_and_gain_limits(controller):
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = Q + np.concatenate([rng.normal(0, 0.2, 7), [0, 0]])
        target = controller.act(q, rng.normal(0, 0.5, 9), START, GOAL)
        position, rotation = forward_kinematics(q[:7])
        assert np.abs(target.position - position).max() <= RESIDUAL_LIMITS_FINAL.position + 1e-12
        assert (
            np.arccos(np.clip((np.trace(target.rotation @ rotation.T) - 1) / 2, -1, 1))
            <= RESIDUAL_LIMITS_FINAL.rotation * 3**0.5 + 1e-6
        )
        assert (target.stiffness >= STIFFNESS_MIN - 1e-9).all() and (target.stiffness <= STIFFNESS_MAX + 1e-9).all()
        assert (target.damping_ratio >= 0.5).all()


def test_another_zeta_of_the_weights_makes_targets_of_another_reach(folder, tmp_path):
    """Trained with twice the residual limits, the same network's first step is twice as long."""
    file = weights_file("post_contact", CARD, folder)
    contract = PolicyContract.of("post_contact", CARD)
    double = {name: 2 * value for name, value in contract.residual_limits.items()}
    other = tmp_path / "double.safetensors"
    other.write_bytes(with_metadata(file.read_bytes(), {KEY: replace(contract, residual_limits=double).text()}))
    position, _ = forward_kinematics(Q[:7])
    near, far = (PostContactPolicy(path, CARD).act(Q, np.zeros(9), START, GOAL) for path in (file, other))
    np.testing.assert_allclose(far.position - position, 2 * (near.position - position), atol=1e-12)


def test_the_last_action_is_seen_and_forgotten_on_reset(controller):
    def run():
        return [controller.act(Q, np.zeros(9), START, GOAL).position.tobytes() for _ in range(3)]

    first = run()
    assert first[0] != first[1]  # same inputs, but an action was taken in between
    controller.reset()
    assert run() == first


def test_a_keypoint_with_a_low_score_is_replaced_by_where_the_box_puts_it(controller):
    clear = controller.act(Q, np.zeros(9), START, GOAL)
    controller.reset()
    hidden = START.copy()
    hidden[3] = 5.0, 200.0, 0.01
    np.testing.assert_allclose(controller.act(Q, np.zeros(9), hidden, GOAL).position, clear.position, atol=1e-5)


def test_without_keypoints_the_last_ones_are_used_and_without_any_the_hand_stays(controller):
    position, rotation = forward_kinematics(NOMINAL.ready)
    target = controller.act(Q, np.zeros(9), None, GOAL)
    np.testing.assert_allclose(target.position, position)
    np.testing.assert_allclose(target.rotation, rotation)
    assert not controller.last_action.any()
    controller.act(Q, np.zeros(9), START, GOAL)
    with_memory = controller.act(Q, np.zeros(9), None, GOAL)
    controller.reset()
    controller.act(Q, np.zeros(9), START, GOAL)
    assert with_memory.position.tobytes() == controller.act(Q, np.zeros(9), START, GOAL).position.tobytes()


def test_a_hand_that_hides_the_object_is_drawn_up_until_it_is_seen_again_or_high_enough(folder):
    controller = PostContactPolicy(weights_file("post_contact", CARD, folder), CARD, reobserve_after=3)
    position, rotation = forward_kinematics(NOMINAL.ready)
    few = START.copy()
    few[:3, 2] = 0.0  # five are left
    blind = [controller.act(Q, np.zeros(9), few, GOAL) for _ in range(3)]
    assert all(np.abs(t.position - position)[:2].max() > 1e-6 for t in blind)  # the policy goes on for so long
    assert position[2] > RETREAT_HEIGHT  # of the ready posture: the hand is high enough and stays
    np.testing.assert_allclose(controller.act(Q, np.zeros(9), None, GOAL).position, position)
    low = Q.copy()
    low[1] += 0.8
    place, turn = forward_kinematics(low[:7])
    assert place[2] < RETREAT_HEIGHT
    target = controller.act(low, np.zeros(9), None, GOAL)
    np.testing.assert_allclose(target.position, place + [0.0, 0.0, RESIDUAL_LIMITS_FINAL.position])
    np.testing.assert_allclose(target.rotation, turn, atol=1e-12)
    assert np.abs(controller.act(low, np.zeros(9), START, GOAL).position - place)[:2].max() > 1e-6
    never = PostContactPolicy(weights_file("post_contact", CARD, folder), CARD, reobserve_after=0)
    never.act(low, np.zeros(9), START, GOAL)
    for _ in range(20):
        assert np.abs(never.act(low, np.zeros(9), None, GOAL).position - place)[:2].max() > 1e-6


def test_a_network_that_gives_nan_is_refused(tmp_path):
    network = PostContactNetwork()
    torch.nn.init.constant_(network.net[-1].bias, float("nan"))
    save(network, tmp_path / "broken.safetensors", PolicyContract.of(POST_CONTACT, CARD))
    with pytest.raises(PolicyError, match="20 finite numbers"):
        PostContactPolicy(tmp_path / "broken.safetensors", CARD).act(Q, np.zeros(9), START, GOAL)


def test_missing_and_foreign_weights_are_named(folder):
    with pytest.raises(WeightsError, match="post_contact_card.safetensors, which does not exist"):
        (folder / "post_contact_card.safetensors").unlink()
        PostContactPolicy(weights_file("post_contact", CARD, folder), CARD)
    with pytest.raises(WeightsError, match="kind: expected post_contact, got pre_contact"):
        PostContactPolicy(weights_file("pre_contact", CARD, folder), CARD)
    save(PreContactNetwork(), weights_file("post_contact", CARD, folder), PolicyContract.of(POST_CONTACT, CARD))
    with pytest.raises(WeightsError, match="does not fit PostContactNetwork"):
        PostContactPolicy(weights_file("post_contact", CARD, folder), CARD)
    with pytest.raises(WeightsError, match="expected a folder"):
        weights_file("pre_contact", CARD, folder / "nowhere")


def test_observations_and_targets_of_many_are_those_of_each():
    """Training asks for thousands at a time, the node for one."""
    rng = np.random.default_rng(0)
    shapes = [(9,), (9,), (8, 2), (8, 2), (3,), (3, 3), (20,)]
    many = [rng.normal(size=(2, 3, *shape)) for shape in shapes]
    one = [array[1, 2] for array in many]
    for function, arguments in (
        (post_contact_observation, slice(0, 7)),
        (student_observation, slice(2, 4)),
        (lambda *arrays: decode(arrays[2], *arrays[:2], RESIDUAL_LIMITS_FINAL).stiffness, slice(4, 7)),
        (lambda *arrays: decode(arrays[2], *arrays[:2], RESIDUAL_LIMITS_FINAL).position, slice(4, 7)),
        (lambda *arrays: decode(arrays[2], *arrays[:2], RESIDUAL_LIMITS_FINAL).rotation, slice(4, 7)),
    ):
        found = function(*many[arguments])
        assert found.shape[:2] == (2, 3)
        np.testing.assert_allclose(found[1, 2], function(*one[arguments]), atol=1e-12)
    in_tensors = student_observation(*map(torch.as_tensor, many[2:4]))
    np.testing.assert_allclose(in_tensors.numpy(), student_observation(*many[2:4]))
    shares = normalise_stiffness(np.stack([STIFFNESS_MIN, (STIFFNESS_MIN + STIFFNESS_MAX) / 2, STIFFNESS_MAX]))
    np.testing.assert_allclose(shares, np.repeat([[0], [0.5], [1]], 7, axis=1))
