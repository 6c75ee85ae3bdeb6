"""What the batched simulator counts: steps beyond the arm's limits, worlds without room for contacts."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
import warp as wp

from np_description.camera import CAMERA
from np_description.contact.depths import PAIRS
from np_description.contact.model import HARD, STEADY
from np_description.contact.penetration import Penetration
from np_description.domains import BUMP, CARD, WALL, Pose
from np_description.objects.choice import domain_with
from np_description.panda import NOMINAL
from np_description.scene import SUPPORT_PROUD
from np_policy.action import Target
from np_training.environment.config import EnvironmentConfig
from np_training.environment.environment import Environment
from np_training.environment.object_poses import corners
from np_training.physics.batched import ARM, BatchedPhysics
from np_training.physics.batched_kinematics import forward_kinematics
from np_training.physics.config import PhysicsConfig, physics_for
from np_training.tasks.randomisation import NOMINAL_CONDITIONS, ROBUST

WORLDS, SUBSTEPS = 4, 3


def test_physics_steps_beyond_a_limit_are_counted_anew_every_period():
    physics = BatchedPhysics(BUMP, WORLDS, "cpu", PhysicsConfig(substeps=SUBSTEPS))
    physics.advance()
    assert not physics.over.any()
    q = physics.qpos[:, ARM].clone()
    physics.qvel[1, 3] = -1.5 * NOMINAL.velocity_limit[3]
    physics.noise[2, 6] = 2 * NOMINAL.torque_limit[6]
    physics.advance()
    velocity, torque = physics.over
    assert velocity[1, 3] >= 1 and torque[2, 6] == SUBSTEPS
    assert not velocity[0].any() and not torque[0].any() and not torque[3].any()
    assert physics.ctrl[2, 6].abs() < NOMINAL.torque_limit[6] < physics.noise[2, 6]
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
    with pytest.raises(ValueError, match="expected one of soft, firm, hard, swift, steady, growing, got 'rigid'"):
        physics_for("rigid")


def test_stiffness_and_damping_of_contacts_differ_between_worlds():
    physics = BatchedPhysics(CARD, 3, "cpu", physics_for("hard", substeps=1))
    nominal = physics.varied._solimp.clone(), physics.varied._solref.clone()
    where, one = torch.tensor([0, 2]), torch.ones(2)
    physics.varied.stiffen(where, torch.tensor([0.25, 4.0]), torch.tensor([1.0, 2.0]))
    share = physics.varied._solimp[:, 0, 1] / (1 - physics.varied._solimp[:, 0, 1])
    assert torch.allclose(share / share[1], torch.tensor([0.25, 1.0, 4.0]), rtol=1e-3)
    assert torch.allclose(physics.varied._solref[:, 0, 1], nominal[1][0, 0, 1] * torch.tensor([1.0, 1.0, 2.0]))
    assert torch.equal(physics.varied._solimp[:, :, 2:], nominal[0][:, :, 2:])  # width and the transition's shape stay
    physics.varied.stiffen(where, one, one)
    assert torch.allclose(physics.varied._solimp, nominal[0]) and torch.allclose(physics.varied._solref, nominal[1])


def test_time_constant_and_creep_of_contacts_differ_between_worlds():
    physics = BatchedPhysics(CARD, 3, "cpu", physics_for("hard", substeps=1))
    solref, creep = physics.varied._solref.clone(), physics.model.opt.impratio_invsqrt.numpy().copy()
    np.testing.assert_allclose(creep, HARD.impratio**-0.5, rtol=1e-6)
    where, one = torch.tensor([0, 2]), torch.ones(2)
    physics.varied.stiffen(where, one, one, torch.tensor([1.0, 2.0]), torch.tensor([0.25, 1.0]))
    assert torch.allclose(physics.varied._solref[:, 0, 0] / solref[:, 0, 0], torch.tensor([1.0, 1.0, 2.0]))
    assert torch.equal(physics.varied._solref[:, :, 1], solref[:, :, 1])
    np.testing.assert_allclose(physics.model.opt.impratio_invsqrt.numpy() / creep, [2.0, 1.0, 1.0], rtol=1e-6)
    physics.varied.stiffen(where, one, one)
    assert torch.equal(physics.varied._solref, solref)
    np.testing.assert_allclose(physics.model.opt.impratio_invsqrt.numpy(), creep, rtol=1e-6)


def test_contacts_are_drawn_between_the_scenes_own_and_hard_ones():
    physics = BatchedPhysics(CARD, 3, "cpu", physics_for("growing", substeps=1))
    varied, everyone, one = physics.varied, torch.arange(3), torch.ones(3)
    geom = physics.host_model.geom("object").id
    before = varied._solimp.clone()
    varied.stiffen(everyone, one, one, onset=torch.tensor([0.0, 0.5, 1.0]))
    for world, model in ((0, STEADY), (2, HARD)):
        np.testing.assert_allclose(varied._solimp[world, geom, :3], model.hard.solimp[:3], rtol=1e-5)
        assert float(varied._creep[world]) == pytest.approx(model.impratio**-0.5)
    first_touch = varied._solimp[:, geom, 0]
    assert first_touch[0] < first_touch[1] < first_touch[2]
    varied.stiffen(everyone, one, one)
    assert torch.allclose(varied._solimp, before)


def test_a_card_creeps_the_further_under_its_load_the_weaker_friction_is_against_the_normal_direction():
    physics = BatchedPhysics(CARD, 2, "cpu", physics_for("hard"))
    everyone = torch.arange(2)
    physics.varied.stiffen(everyone, torch.ones(2), torch.ones(2), 1.0, torch.tensor([1.0, 0.1]))
    qpos = physics.qpos.clone()
    qpos[:, 9:16] = torch.tensor([0.5, 0.0, CARD.half_size[2], 1.0, 0.0, 0.0, 0.0])
    physics.place(everyone, qpos)
    physics.advance()  # settles
    applied = wp.to_torch(physics.data.xfrc_applied)
    applied[:, physics.varied.object_body, 0] = 0.8 * HARD.table * CARD.mass * 9.81
    physics.advance()
    moved = physics.qpos[:, 9] - 0.5
    assert moved[0].abs() < 1e-6 and 4e-6 < moved[1] < 1e-4


def test_fingertips_reach_further_and_turn_in_the_worlds_where_they_are_bent():
    physics = BatchedPhysics(CARD, 2, "cpu", physics_for("hard", substeps=1))
    qpos = physics.qpos.clone()
    physics.advance()  # geoms are where they were at a step's beginning
    (where, turned), tips = (array.clone() for array in physics.geoms), physics.varied._tips
    bent, straight = torch.tensor([1]), torch.zeros(1, 2, 3)
    turn = straight.clone()
    turn[0, 1, 0] = 0.02
    physics.varied.bend(bent, torch.tensor([[3e-4, 0.0]]), turn)
    physics.qpos.copy_(qpos)
    physics.qvel.zero_()
    physics.advance()
    moved = physics.geoms[0] - where
    assert moved[0].abs().max() < 1e-5 and moved[1, tips[1]].norm() < 1e-5
    assert moved[1, tips[0]].norm() == pytest.approx(3e-4, abs=1e-5)
    between = turned[1, tips[1]].T @ physics.geoms[1][1, tips[1]]
    assert torch.arccos((between.trace() - 1) / 2) == pytest.approx(0.02, abs=1e-3)


def test_strange_conditions_reach_the_physics():
    config = EnvironmentConfig(worlds=64, conditions=ROBUST, physics=physics_for("swift", substeps=1, supports=True))
    env = Environment(CARD, "cpu", config)
    env.draws.draw(env.config.conditions, torch.arange(64), env.physics.qpos[:, ARM])
    times = env.physics.varied._solref[:, 0, 0] / env.physics.varied._reference[0, 0]
    assert 0.8 <= times.min() < 1.0 and 2 < times.max() <= 2.5
    impratio = torch.tensor(env.physics.model.opt.impratio_invsqrt.numpy()) ** -2
    assert 1 <= impratio.min() < 2 and 15 < impratio.max() <= 30.01
    length = env.physics.varied._place[0][:, env.physics.varied._tips, 2] - env.physics.varied._tip_place[0][:, 2]
    assert length.abs().max() <= 3e-4 and length.min() < -2e-4 and length.max() > 2e-4


def test_a_margin_of_speed_counts_before_the_data_sheet_does():
    physics = BatchedPhysics(CARD, 2, "cpu", PhysicsConfig(substeps=1))
    physics.margin[1] = 0.75
    physics.qvel[:, 0] = 0.9 * float(NOMINAL.velocity_limit[0])
    physics.advance()
    assert physics.over[0, 0, 0] == 0 and physics.over[0, 1, 0] == 1


def test_robust_conditions_reach_the_physics():
    config = EnvironmentConfig(worlds=64, conditions=ROBUST, physics=physics_for("hard", substeps=1, supports=True))
    env = Environment(CARD, "cpu", config)
    env.draws.draw(env.config.conditions, torch.arange(64), env.physics.qpos[:, ARM])
    share = env.physics.varied._solimp[:, 0, 1] / (1 - env.physics.varied._solimp[:, 0, 1])
    nominal = HARD.hard.impedance[1] / (1 - HARD.hard.impedance[1])
    low, high = ROBUST.stiffness
    assert 0.95 * low * nominal < share.min() < 0.6 * nominal and 1.8 * nominal < share.max() < 1.05 * high * nominal
    low, high = ROBUST.limit_margin
    assert low <= env.physics.margin.min() < env.physics.margin.max() <= high
    low, high = (2 * steps for steps in ROBUST.delay)  # steps of 2.5 ms
    assert low <= env.physics.delay.min() and env.physics.delay.max() <= high and (env.physics.delay % 2 == 0).all()


def test_shares_of_limits_are_the_largest_of_the_period():
    physics = BatchedPhysics(CARD, 2, "cpu", PhysicsConfig(substeps=SUBSTEPS))
    physics.qvel[1, 2] = 0.5 * float(NOMINAL.velocity_limit[2])
    physics.noise[0, 6] = 0.4 * float(NOMINAL.torque_limit[6])
    physics.advance()
    velocity, torque = physics.peak
    assert velocity[1, 2] == pytest.approx(0.5, abs=1e-6) and velocity[0, :6].max() < 0.05
    assert torque[0, 6] == pytest.approx(0.4, abs=0.02)
    physics.qvel.zero_()
    physics.noise.zero_()
    physics.advance()
    assert physics.peak[1, 0, 6] < 0.1


def test_torque_is_cut_at_the_margin():
    physics = BatchedPhysics(CARD, 2, "cpu", PhysicsConfig(substeps=1))
    physics.margin[1] = 0.75
    physics.noise[:, 6] = 2 * NOMINAL.torque_limit[6]
    physics.applied[:, 6] = 0.9 * NOMINAL.torque_limit[6]  # from which both are within a step of the torque rate
    physics.advance()
    assert torch.allclose(physics.ctrl[:, 6], torch.tensor([1.0, 0.75]) * NOMINAL.torque_limit[6])


@pytest.mark.parametrize("contact", ("soft", "hard"))
def test_depths_of_all_worlds_are_those_that_one_scene_shows(contact):
    physics = BatchedPhysics(CARD, 3, "cpu", physics_for(contact, substeps=1))
    qpos = physics.qpos.clone()
    qpos[:, 9:12] = torch.tensor([0.5, 0.0, 0.0025])
    qpos[1, 11] -= 0.001  # in the table
    q = torch.tensor(NOMINAL.ready).float()
    tcp = float(forward_kinematics(q[None])[0][0, 2])
    qpos[2, 9:12] = torch.tensor([float(forward_kinematics(q[None])[0][0, 0]), 0.0, tcp - 0.010])
    physics.place(torch.arange(3), qpos)
    physics.hold(torch.arange(3), qpos[:, ARM])
    physics.advance()
    judge = Penetration(CARD, physics.config.contact)
    # The simulator's contacts are those at the beginning of its step.
    found = physics.contacts.depths().numpy()
    for row, wanted in zip(found, qpos.numpy()):
        expected = judge.depths(wanted[:9].astype(float), Pose(wanted[9:12].astype(float), wanted[12:16].astype(float)))
        for pair, depth in zip(PAIRS, row):
            assert depth == pytest.approx(expected.get(pair, 0.0), abs=1e-5), pair
    assert found[2, PAIRS.index("finger-object")] > 1e-4
    assert physics.contacts.touching("finger-object").tolist() == [False, False, True]


def test_an_object_on_small_patches_turns_more_easily():
    """Spun about the vertical it comes to rest after an angle in inverse proportion to the radius at which friction acts."""
    physics = BatchedPhysics(CARD, 2, "cpu", physics_for("hard", substeps=2, supports=True))
    physics.varied.support(torch.tensor([0, 1]), torch.tensor([[0.97] * 3, [0.45] * 3]))
    qpos = physics.qpos.clone()
    qpos[:, 9:12] = torch.tensor([0.5, 0.0, 0.0025 + SUPPORT_PROUD])
    physics.place(torch.arange(2), qpos)
    for _ in range(20):
        physics.advance()
    physics.qvel[:, 14] = 3.0  # rad/s, about the object's z
    physics.advance()
    lost = 3.0 - physics.qvel[:, 14]
    assert float(lost[0] / lost[1]) == pytest.approx(0.97 / 0.45, rel=0.2)


def test_limits_of_range_leave_the_start_inside():
    env = Environment(
        CARD, "cpu", EnvironmentConfig(worlds=16, conditions=ROBUST, physics=PhysicsConfig(supports=True))
    )
    q = torch.tensor(NOMINAL.position_lower).float().repeat(16, 1) + 0.15
    env.draws.draw(env.config.conditions, torch.arange(16), q)
    lower, upper = (torch.tensor(list(end)).float() for end in (NOMINAL.position_lower, NOMINAL.position_upper))
    assert (env.draws.range[0] <= q - 0.099).all() and (env.draws.range[0] >= lower - 1e-6).all()
    share = (env.draws.range[1] - (lower + upper) / 2) / ((upper - lower) / 2)
    assert torch.allclose(share, env.physics.margin[:, None].expand(16, 7), atol=1e-5)


def test_keypoints_are_as_old_as_the_image():
    conditions = replace(NOMINAL_CONDITIONS, image_latency=(0.05, 0.05))
    env = Environment(CARD, "cpu", EnvironmentConfig(worlds=2, conditions=conditions))
    env.draws.draw(env.config.conditions, torch.arange(2), env.physics.qpos[:, ARM])
    env.goals.quaternion[:, 0] = 1.0
    env.physics.qpos[:, 9:12] = torch.tensor([0.5, 0.0, 0.0025])
    env._past.remember(env._corners_now())
    env.physics.qpos[:, 10] += 0.02
    seen = env._seen_corners(env.objects)
    middle = seen.mean(1)
    assert torch.allclose(middle[:, 1], torch.tensor(0.01), atol=1e-6)


def test_a_camera_that_is_off_shifts_what_is_seen():
    conditions = replace(NOMINAL_CONDITIONS, camera_position=0.003, camera_rotation=0.003)
    env = Environment(CARD, "cpu", EnvironmentConfig(worlds=512, conditions=conditions))
    env.draws.draw(env.config.conditions, torch.arange(512), env.physics.qpos[:, ARM])
    env.physics.qpos[:, 9:12] = torch.tensor([0.5, 0.0, 0.0025])
    moved = (env._seen_corners(env.objects) - corners(CARD, env.objects)).mean(1)
    distance = np.linalg.norm(np.array([0.5, 0.0, 0.0025]) - CAMERA.position)
    assert float(moved[:, 1].std()) == pytest.approx(0.003 * np.hypot(1, distance), rel=0.15)
    assert moved.mean(0).abs().max() < 1e-3


@pytest.mark.parametrize("in_image", [False, True])
def test_who_lies_on_a_goal_seen_by_the_same_camera_looks_like_it(in_image):
    conditions = replace(NOMINAL_CONDITIONS, camera_position=0.003, camera_rotation=0.003, goal_in_image=in_image)
    env = Environment(CARD, "cpu", EnvironmentConfig(worlds=64, conditions=conditions))
    env.draws.draw(env.config.conditions, torch.arange(64), env.physics.qpos[:, ARM])
    env.goals.position.copy_(torch.tensor([0.5, 0.05, 0.0025]))
    env.goals.quaternion[:, 0] = 1.0
    env.physics.qpos[:, 9:12], env.physics.qpos[:, 12:16] = env.goals.position, env.goals.quaternion
    state, _ = env.observe()
    apart = state[:, 34:50]  # goal less keypoints
    assert (apart.abs().max() < 1e-4) == in_image


def test_a_rigid_object_is_trained_with_its_own_mass_and_friction_and_another_is_refused():
    physics = BatchedPhysics(domain_with("card", "wood"), WORLDS, "cpu", PhysicsConfig(substeps=SUBSTEPS))
    assert physics.varied.mass[:, physics.varied.object_body].tolist() == pytest.approx([0.008] * WORLDS)
    assert physics.varied.friction[0, physics.host_model.geom("table").id, 0] == pytest.approx(0.45)
    with pytest.raises(ValueError, match="object: training moves rigid ones, got tissue, which has moving parts"):
        BatchedPhysics(domain_with("card", "tissue"), WORLDS, "cpu")
