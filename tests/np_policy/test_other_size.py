"""Contacts on an object of another size than the weights know: the hand stands before it as before the one they know."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from np_common.rotations import matrix_from_quaternion, matrix_from_vector, quaternion_from_matrix
from np_control.kinematics import solve_ik
from np_description.contact.model import HARD, SOFT
from np_description.domains import BUMP, CARD, DOMAINS, WALL, Pose, resting_pose, sample_task
from np_description.objects.choice import object_reference, place_object
from np_description.objects.table import rows_of
from np_description.panda import NOMINAL
from np_description.scene import OBJECT
from np_description.weights.header import read_metadata
from np_perception.pose_estimation import project_keypoints
from np_planning.collision import CollisionModel
from np_planning.stand_off import CLEARANCE, finger_gap
from np_policy.action import PolicyError
from np_policy.contract import PRE_CONTACT, PolicyContract, weights_file
from np_policy.networks import PreContactNetwork
from np_policy.policy import PreContactPolicy
from np_policy.size_generalization import (
    SIZES,
    canonical_object_position,
    find_trained_domain,
    read_size_range,
    transfer_contact_position,
)
from np_policy.weights import save

FLAT = np.array([1.0, 0, 0, 0])


def sized(domain, *factors: float):
    """The domain with its own object in another size."""
    spec = rows_of(domain.name)["default"].spec
    return place_object(domain, replace(spec, size=tuple((np.array(spec.size) * factors).tolist())))


def before(domain, object_pose: Pose, hand: Pose, opening: float):
    """`finger_gap` of poses."""
    return finger_gap(
        domain,
        object_pose.position,
        object_pose.quaternion,
        hand.position,
        matrix_from_quaternion(hand.quaternion),
        opening,
    )


def nearest_finger(domain, object_pose: Pose, hand: Pose, opening: float) -> float:
    """Distance m of the nearest finger to the object, measured by MuJoCo between its shapes."""
    model = CollisionModel(domain)
    model.place(object_pose, opening)
    model.data.qpos[:7] = solve_ik(
        NOMINAL.ready, hand.position, matrix_from_quaternion(hand.quaternion), iterations=100
    )
    mujoco.mj_kinematics(model.model, model.data)
    box = model.model.geom(OBJECT).id
    fingers = [g for g in range(model.model.ngeom) if model.model.geom(g).name.startswith("panda_finger")]
    return min(mujoco.mj_geomDistance(model.model, model.data, g, box, 0.2, None) for g in fingers)


@pytest.mark.parametrize("contact", [HARD, SOFT], ids=["flat", "round"])
def test_the_gap_is_what_is_between_the_fingers_and_the_face(contact):
    domain = replace(sized(BUMP, 2.2, 2.2, 1.1), contact=contact)  # a face that the fingers do not reach beyond
    object_pose, rng = Pose(np.array([0.5, 0.0, 0.05]), FLAT), np.random.default_rng(0)
    for _ in range(20):
        turn = matrix_from_vector(np.array([*rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.5, 1.0)]))
        hand = Pose(
            object_pose.position + [0.0, 0.0, rng.uniform(0.075, 0.1)],
            quaternion_from_matrix(turn @ np.diag([1.0, -1, -1])),
        )
        opening = rng.uniform(0.0, 0.02)
        apart, normal = before(domain, object_pose, hand, opening)
        np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-12)
        assert apart == pytest.approx(nearest_finger(domain, object_pose, hand, opening), abs=2e-4)


@pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS)
def test_what_has_the_size_that_the_weights_know_is_seen_as_it_is(domain):
    assert find_trained_domain(domain) is None
    for row in rows_of(domain.name).values():
        assert find_trained_domain(place_object(domain, row.spec)) is None
    tea = sized(domain, 1.1, 1.0, 1.0)
    assert find_trained_domain(tea) is domain
    assert find_trained_domain(tea, object_reference(tea)) is None  # weights that were trained for it
    assert find_trained_domain(domain, object_reference(tea)).half_size == tea.half_size


def test_weights_that_were_trained_with_sizes_see_these_as_they_are_and_others_do_not(tmp_path):
    """A range is of all edges together: a box of other proportions is known to nobody."""
    sizes = (0.8, 1.2)
    for factor, known in ((0.8, True), (1.0, True), (1.2, True), (0.75, False), (1.3, False)):
        assert (find_trained_domain(sized(WALL, factor, factor, factor), sizes=sizes) is None) == known
    assert find_trained_domain(sized(WALL, 1.1, 1.0, 1.0), sizes=sizes) is WALL
    large, contract = sized(BUMP, 1.2, 1.2, 1.2), PolicyContract.of(PRE_CONTACT, BUMP)
    start, goal = sample_task(large, np.random.default_rng(0))
    seen = [project_keypoints(large, pose) for pose in (start, goal)]
    chosen = []
    for name, metadata in (("one", {}), ("many", {SIZES: "0.8 1.2"})):
        torch.manual_seed(0)
        save(PreContactNetwork(), tmp_path / f"{name}.safetensors", contract, metadata)
        chosen += [PreContactPolicy(tmp_path / f"{name}.safetensors", other).propose(*seen) for other in (large, BUMP)]
    carried, plain, many, same = (one.pose.position for one in chosen)
    np.testing.assert_array_equal(many, plain)
    np.testing.assert_array_equal(many, same)
    assert np.linalg.norm(carried - plain) > 0.004


def test_the_known_box_rests_where_the_object_rests():
    tall = sized(WALL, 1.2, 1.2, 1.2)
    for region, roll in ((tall.start, 0.0), (tall.goals[0], 0.0), (tall.start, np.pi / 2)):
        there = resting_pose(tall, region, 0.5, 0.1, 0.3, roll, region.pitch)
        same = resting_pose(WALL, region, 0.5, 0.1, 0.3, roll, region.pitch)
        np.testing.assert_array_equal(there.quaternion, same.quaternion)
        np.testing.assert_allclose(
            canonical_object_position(tall, WALL, there.position, there.quaternion), same.position, atol=1e-12
        )


@pytest.mark.parametrize("domain", [BUMP, WALL], ids=lambda domain: domain.name)
@pytest.mark.parametrize("factor", [0.8, 0.9, 1.1, 1.2])
def test_the_released_weights_choose_a_contact_that_can_be_reached_at_another_size(domain, factor):
    """Weights of one size would choose one that is off by half the difference, or in the object; those of a range see sizes."""
    other, file = sized(domain, *[factor] * 3), weights_file(PRE_CONTACT, domain)
    assert read_size_range(read_metadata(file)) == (0.8, 1.2)
    policies = PreContactPolicy(file, other), PreContactPolicy(file, domain)
    rng, apart, nearest, beside = np.random.default_rng(0), [], [], []
    for _ in range(40):
        start, goal = sample_task(other, rng)
        seen = [project_keypoints(other, pose) for pose in (start, goal)]
        chosen, unaware = (policy.propose(*seen) for policy in policies)
        apart.append([before(other, start, one.pose, one.opening)[0] for one in (chosen, unaware)])
        nearest.append(nearest_finger(other, start, chosen.pose, chosen.opening))
        local = matrix_from_quaternion(start.quaternion).T @ (chosen.pose.position - start.position)
        beside.append(np.sort(np.abs(local) / other.half_size)[1])
    assert np.quantile(beside, 0.9) < 1.1 and max(beside) < 1.2  # over the face, at most a finger over its edge
    # The wall's student is 0.3 mm from its teacher, the bump's 1.2 mm: the approach moves out what would touch.
    most = {BUMP: 0.003, WALL: 0.001}[domain]
    off = np.subtract(apart, CLEARANCE)
    assert (np.abs(np.median(off, 0)) < 0.0005).all()
    assert (np.quantile(np.abs(off), 0.9, axis=0) < most).all()
    assert CLEARANCE - most < np.quantile(nearest, 0.1) and np.quantile(nearest, 0.9) < 0.0025 + CLEARANCE + most


def test_a_pose_before_a_face_is_carried_along_it_in_proportion_and_stands_off_as_far():
    wide = sized(BUMP, 1.2, 0.9, 1.1)
    known = Pose(np.array([0.5, 0.1, 0.045]), FLAT)
    object_pose = Pose(np.array([0.5, 0.1, 0.045 * 1.1]), FLAT)
    down, hand = np.diag([1.0, -1.0, -1.0]), known.position + [0.02, -0.01, 0.06]
    there = transfer_contact_position(wide, BUMP, object_pose.position, object_pose.quaternion, hand, down, 0.0)
    np.testing.assert_allclose((there - object_pose.position)[:2], [0.024, -0.009], atol=1e-12)
    assert finger_gap(wide, object_pose.position, object_pose.quaternion, there, down, 0.0)[0] == pytest.approx(
        CLEARANCE
    )


def test_batches_of_tensors_are_carried_over_as_single_poses_are():
    other, rng = sized(WALL, 1.2, 0.9, 1.1), np.random.default_rng(0)
    poses = [sample_task(other, rng)[rng.integers(2)] for _ in range(6)]
    position, quaternion = (np.array([getattr(pose, name) for pose in poses]) for name in ("position", "quaternion"))
    hand = position + rng.normal(0, 0.08, (6, 3))
    rotation, opening = matrix_from_vector(rng.normal(0, 1, (6, 3))), rng.uniform(0, 0.02, 6)
    arguments = position, quaternion, hand, rotation, opening
    together = transfer_contact_position(other, WALL, *(torch.from_numpy(values) for values in arguments)).numpy()
    for row, one in enumerate(zip(*arguments)):
        np.testing.assert_allclose(together[row], transfer_contact_position(other, WALL, *one), atol=1e-9)


def test_keypoints_without_a_pose_are_refused_in_words(tmp_path):
    torch.manual_seed(0)
    file = weights_file(PRE_CONTACT, CARD, tmp_path)
    save(PreContactNetwork(), file, PolicyContract.of(PRE_CONTACT, CARD))
    planner = PreContactPolicy(file, sized(CARD, 1.2, 1.2, 1.2))
    start, goal = (project_keypoints(CARD, pose) for pose in sample_task(CARD, np.random.default_rng(0)))
    start[:4, 2] = 0.0
    with pytest.raises(PolicyError, match="a size it was not trained with: expected at least 6 of 8 keypoints"):
        planner.propose(start, goal)
