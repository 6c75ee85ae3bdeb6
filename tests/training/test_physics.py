"""What the batched simulator counts: steps beyond the arm's limits, worlds without room for contacts."""

import numpy as np
import pytest
import torch

from np_description.domains import BUMP, WALL
from np_description.panda import NOMINAL
from np_policy.action import Target
from np_training.physics.batched import ARM, CONTROLLERS, BatchedPhysics, PhysicsConfig

WORLDS, SUBSTEPS = 4, 3


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_physics_steps_beyond_a_limit_are_counted_anew_every_period(controller):
    physics = BatchedPhysics(BUMP, WORLDS, "cpu", PhysicsConfig(substeps=SUBSTEPS, controller=controller))
    physics.advance()
    assert not physics.over.any()
    q = physics.qpos[:, ARM].clone()
    physics.qvel[1, 3] = -1.5 * NOMINAL.velocity_limit[3]
    physics.noise[2, 6] = 2 * NOMINAL.torque_limit[6]
    physics.advance()
    velocity, torque = physics.over
    assert velocity[1, 3] >= 1 and torque[2, 6] == SUBSTEPS
    assert not velocity[0].any() and not torque[0].any() and not torque[3].any()
    assert physics.ctrl[2, 6] == pytest.approx(NOMINAL.torque_limit[6])
    physics.noise.zero_()
    physics.place(torch.arange(WORLDS), torch.cat([q, physics.qpos[:, 7:]], -1))
    physics.hold(torch.arange(WORLDS), q)
    physics.advance()
    assert not physics.over.any()


def test_worlds_without_room_for_a_constraint_are_counted_once():
    roomy, narrow = (
        BatchedPhysics(BUMP, WORLDS, "cpu", PhysicsConfig(substeps=SUBSTEPS, constraints=room)) for room in (96, 22)
    )  # 24 are in use at rest
    for physics in (roomy, narrow):
        physics.advance()
    assert roomy.take_overflowed() == 0
    assert narrow.take_overflowed() == WORLDS and narrow.take_overflowed() == 0


def test_a_target_takes_the_place_of_the_one_before_it_and_keeps_that_for_the_delay():
    physics = BatchedPhysics(BUMP, WORLDS, "cpu", PhysicsConfig(substeps=SUBSTEPS))
    q = physics.qpos[:, ARM].clone()
    for k in (1.0, 2.0):
        gains = torch.full_like(q, 100 * k), torch.full_like(q, k)
        physics.aim(q + k, Target(torch.zeros(WORLDS, 3), torch.eye(3).repeat(WORLDS, 1, 1), *gains))
    expected = torch.stack(
        [
            q + 1,
            *(torch.full_like(q, x) for x in (100.0, 1.0)),
            q + 2,
            *(torch.full_like(q, x) for x in (200.0, 2.0)),
        ]
    )
    np.testing.assert_allclose(physics.command.numpy(), expected.numpy())


@pytest.mark.parametrize("domain", [BUMP, WALL], ids=lambda d: d.name)
def test_objects_rest_on_obstacles_as_deep_as_they_were_sunk(domain):
    physics = BatchedPhysics(domain, WORLDS, "cpu")
    everyone, (obstacle,) = torch.arange(WORLDS), domain.obstacles
    top, half = obstacle.centre[2] + obstacle.half_size[2], domain.half_size[2]
    for sunk in (torch.tensor([0.0, 0.3, 0.6, 0.9]) * top, torch.zeros(WORLDS)):
        qpos = physics.qpos.clone()
        qpos[:, 9:16] = torch.tensor([*obstacle.centre[:2], 0.0, 1.0, 0.0, 0.0, 0.0])
        qpos[:, ARM] = torch.tensor(NOMINAL.ready)
        qpos[:, 11] = top - sunk + half + 0.002
        physics.place(everyone, qpos, sunk)
        physics.hold(everyone, qpos[:, ARM])
        for _ in range(3):
            physics.advance()
        assert torch.allclose(physics.qpos[:, 11], top - sunk + half, atol=1e-3)
