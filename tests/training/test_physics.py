"""What the batched simulator counts: steps beyond the arm's limits, worlds without room for contacts."""

import mujoco
import numpy as np
import pytest
import torch

from np_description.contact import HARD
from np_description.domains import BUMP, CARD, WALL
from np_description.panda import NOMINAL
from np_policy.action import Target
from np_training.environment.environment import Environment, EnvironmentConfig
from np_training.physics.batched import ARM, CONTROLLERS, BatchedPhysics, PhysicsConfig, physics_for
from np_training.tasks.randomisation import ROBUST

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


def test_hard_contact_is_stepped_twice_as_often_and_holds_a_policy_period():
    soft, hard = physics_for("soft"), physics_for("hard")
    for config in (soft, hard):
        assert config.timestep * config.substeps == pytest.approx(0.1)
    assert soft == PhysicsConfig() and hard.contact is HARD
    physics = BatchedPhysics(CARD, 1, "cpu", physics_for("hard", substeps=1))
    assert physics.host_model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert physics.host_model.opt.ls_iterations >= HARD.line_search
    with pytest.raises(ValueError, match="expected one of soft, hard, got 'rigid'"):
        physics_for("rigid")


def test_stiffness_and_damping_of_contacts_differ_between_worlds():
    physics = BatchedPhysics(CARD, 3, "cpu", physics_for("hard", substeps=1))
    nominal = physics._solimp.clone(), physics._solref.clone()
    where, one = torch.tensor([0, 2]), torch.ones(2)
    physics.stiffen(where, torch.tensor([0.25, 4.0]), torch.tensor([1.0, 2.0]))
    share = physics._solimp[:, 0, 1] / (1 - physics._solimp[:, 0, 1])
    assert torch.allclose(share / share[1], torch.tensor([0.25, 1.0, 4.0]), rtol=1e-3)
    assert torch.allclose(physics._solref[:, 0, 1], nominal[1][0, 0, 1] * torch.tensor([1.0, 1.0, 2.0]))
    assert torch.equal(physics._solimp[:, :, 2:], nominal[0][:, :, 2:])  # width and the transition's shape stay
    physics.stiffen(where, one, one)
    assert torch.allclose(physics._solimp, nominal[0]) and torch.allclose(physics._solref, nominal[1])


def test_a_margin_of_speed_counts_before_the_data_sheet_does():
    physics = BatchedPhysics(CARD, 2, "cpu", PhysicsConfig(substeps=1))
    physics.margin[1] = 0.75
    physics.qvel[:, 0] = 0.9 * float(NOMINAL.velocity_limit[0])
    physics.advance()
    assert physics.over[0, 0, 0] == 0 and physics.over[0, 1, 0] == 1


def test_robust_conditions_reach_the_physics():
    config = EnvironmentConfig(worlds=64, conditions=ROBUST, physics=physics_for("hard", substeps=1))
    env = Environment(CARD, "cpu", config)
    env._draw_conditions(torch.arange(64))
    share = env.physics._solimp[:, 0, 1] / (1 - env.physics._solimp[:, 0, 1])
    nominal = HARD.hard.impedance[1] / (1 - HARD.hard.impedance[1])
    assert 0.24 * nominal < share.min() < 0.6 * nominal and 1.8 * nominal < share.max() < 4.2 * nominal
    assert 0.75 <= env.physics.margin.min() < env.physics.margin.max() <= 0.95
    low, high = (2 * steps for steps in ROBUST.delay)  # steps of 2.5 ms
    assert low <= env.physics.delay.min() and env.physics.delay.max() <= high and (env.physics.delay % 2 == 0).all()
