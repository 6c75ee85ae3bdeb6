"""Contacts that a policy chooses: the pose of the hand at a face of the object, and whether the arm reaches it."""

import pytest
import torch

from np_common.rotations import matrix_from_quaternion
from np_control.kinematics import pose_distance
from np_description.domains import BUMP, CARD, DOMAINS, WALL
from np_description.hand import FLAT_HAND, ROUND_HAND
from np_description.panda import NOMINAL
from np_training.environment import contact
from np_training.environment.object_poses import pre_contact_state
from np_training.ppo.networks import PreContactActor
from np_training.tasks import practice
from np_training.tasks.poses import sample_tasks


def test_contacts_put_the_fingertip_over_the_chosen_point():
    objects, _ = sample_tasks(CARD, 500, torch.Generator().manual_seed(3))
    action = torch.zeros(500, contact.SIZE)
    action[:, 0] = torch.linspace(-0.9, 0.9, 500)
    action[:, 3], action[:, 8] = -1.0, 1.0  # closed fingers, centre of the upper face
    contacts = contact.resolve(CARD, action, objects)
    assert contacts.feasible.all()
    distance, angle = pose_distance(contacts.q, contacts.position, contacts.rotation)
    assert distance.max() < 1e-3 and angle.max() < 1e-2
    depth = (
        NOMINAL.frames["hand_finger1"].position[2] + CARD.contact.hand.tip.centre[2]
    )  # of the middle of the fingertips
    tip = contacts.position + contacts.rotation[:, :, 2] * (depth - NOMINAL.frames["hand_tcp"].position[2])
    top = objects.position + torch.tensor([0, 0, CARD.half_size[2]])
    assert (tip - top)[:, :2].norm(dim=-1).max() < 1e-6
    clearance = contact.gripper_clearance(CARD, contacts.q, contacts.width, objects)
    assert torch.allclose(clearance, torch.full_like(clearance, contact.CLEARANCE), atol=1e-3)


@pytest.mark.parametrize("hand", (ROUND_HAND, FLAT_HAND), ids=("round", "flat"))
@pytest.mark.parametrize("domain", DOMAINS.values(), ids=lambda d: d.name)
def test_contacts_keep_the_fingers_off_the_chosen_face(domain, hand):
    generator = torch.Generator().manual_seed(5)
    objects, _ = sample_tasks(domain, 1000, generator)
    action = 2 * torch.rand(1000, contact.SIZE, generator=generator) - 1
    point, normal = contact.surface_point(domain, action[:, 6:], objects)
    local = (matrix_from_quaternion(objects.quaternion).mT @ (point - objects.position)[..., None])[..., 0].abs()
    half_size = torch.tensor(domain.half_size)
    assert (local <= half_size + 1e-6).all() and ((local - half_size).abs() < 1e-6).any(-1).all()
    assert ((point - objects.position) * action[:, 6:]).sum(
        -1
    ).min() > 0  # in the base frame, whatever the object's yaw
    position, rotation, width = contact.contact_pose(domain, action, objects, hand)
    centres, radii = contact.gripper_spheres(position, rotation, width, hand, with_housing=False)
    height = (((centres - point[:, None]) * normal[:, None]).sum(-1) - radii).amin(-1)
    assert torch.allclose(height, torch.full_like(height, contact.CLEARANCE), atol=1e-6)


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.2])
def test_contacts_that_a_student_puts_into_the_object_come_out_before_the_same_face(factor):
    generator = torch.Generator().manual_seed(8)
    objects, _ = sample_tasks(BUMP, 500, generator)
    objects = practice.scale_poses(BUMP, objects, torch.full((500, 3), factor))
    action = 2 * torch.rand(500, contact.SIZE, generator=generator) - 1
    action[:, 6:8] *= 0.3  # near the middle of an upper face
    action[:, 8] = 1.0
    position, rotation, width = contact.contact_pose(BUMP, action, objects)
    assert torch.equal(contact.draw_out(BUMP, position, rotation, width, objects), position)
    _, normal = contact.surface_point(BUMP, action[:, 6:], objects)
    depth = 0.005 + 0.005 * torch.rand(500, generator=generator)
    out = contact.draw_out(BUMP, position - depth[:, None] * normal, rotation, width, objects)
    assert torch.allclose(out, position, atol=1e-6)


@pytest.mark.parametrize("domain", [BUMP, WALL], ids=lambda d: d.name)
def test_most_contacts_of_an_untrained_policy_can_be_reached(domain):
    torch.manual_seed(0)
    objects, goals = sample_tasks(domain, 2000, torch.Generator().manual_seed(6))
    action, _ = PreContactActor().act(pre_contact_state(objects, goals), explore=0.0)
    _, normal = contact.surface_point(domain, action.clamp(-1, 1)[:, 6:], objects)
    feasible, side = contact.resolve(domain, action, objects).feasible, normal[:, 2].abs() < 0.5
    assert 0.2 < side.float().mean() < 0.6
    assert feasible[~side].float().mean() > 0.9
    # The wide hand has no room between the wall and the sides of a box that stands before it.
    assert feasible[side].float().mean() > (0.8 if domain is BUMP else 0.25)


def test_a_contact_inside_the_table_is_refused():
    objects, _ = sample_tasks(CARD, 50, torch.Generator().manual_seed(4))
    action = torch.zeros(50, contact.SIZE)
    action[:, 8] = -1.0  # the face the card lies on
    assert not contact.resolve(CARD, action, objects).feasible.any()
