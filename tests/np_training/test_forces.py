"""Forces in the batched simulator: the estimate against the robot's own way, the reflex in training, and what a touch costs."""

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import torch

from np_control.kinematics import jacobian
from np_description.domains import CARD
from np_description.force_reflex import filter_step, hand_wrench, threshold_share
from np_policy import action as actions
from np_training.environment.config import LOOSE_FORCE, EnvironmentConfig, force_scale
from np_training.environment.environment import Environment
from np_training.physics.batched_forces import BARE, FINGER, FORCE, RAW, SHARE
from np_training.physics.batched_kinematics import forward_kinematics, solve_ik
from np_training.physics.config import physics_for
from np_training.tasks.rewards import FORCE_FREE, FORCE_SPAN, RewardConfig, saturating

WORLDS = 3
EVERYONE = torch.arange(WORLDS)


class RandomContacts:
    """Contacts anywhere on the object."""

    def act(self, state, explore):
        generator = torch.Generator().manual_seed(1)
        return 2 * torch.rand(len(state), 9, generator=generator) - 1, torch.zeros(len(state))


def environment(**changes) -> Environment:
    config = EnvironmentConfig(worlds=WORLDS, limit=50, physics=physics_for("growing"), **changes)
    env = Environment(CARD, "cpu", config)
    env.starts = env.draw_starts(RandomContacts(), 40)
    env.reset(EVERYONE)
    return env


def press(share: float) -> torch.Tensor:
    """An action that moves the hand down by a share of the residual limit, stiffly."""
    action = torch.zeros(WORLDS, actions.SIZE)
    action[:, 2], action[:, actions.STIFFNESS] = -share, 0.5
    return action


def test_the_estimate_agrees_with_measured_motion_and_with_the_deployed_definition():
    """M dv/dt + h - commands, from positions, velocities and commands alone, filtered, is what the kernel finds with the solver's forces."""
    env = environment(force_reflex=False)
    physics, model = env.physics, env.physics.host_model
    data, dt = mujoco.MjData(model), env.config.physics.timestep
    ones = torch.ones(WORLDS, 7)
    physics.varied.wear(EVERYONE, 0 * ones, ones, ones)  # a stuck joint's friction is no function of its motion
    model.dof_frictionloss[:7] = 0
    filtered, largest = np.zeros((WORLDS, 7)), 0.0
    peaks = np.zeros((3, WORLDS))
    mass = np.zeros((model.nv, model.nv))
    position, rotation = env_pose(env)
    target = actions.decode(press(1.0), position, rotation, env.limits)
    physics.aim(solve_ik(physics.seen_q[:, :7].clone(), target.position, target.rotation), target)
    for substep in range(env.config.physics.substeps):
        q, v = physics.qpos.double().numpy().copy(), physics.qvel.double().numpy().copy()
        physics._command_torque(substep)
        command = physics.ctrl.double().numpy()[:, :7].copy()
        mjw.step(physics.model, physics.data)
        physics.forces.watch(substep)
        q_after, v_after = physics.qpos.double().numpy(), physics.qvel.double().numpy()
        for i in range(WORLDS):
            data.qpos, data.qvel = q[i], v[i]
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, mass)
            passive = data.qfrc_gravcomp[:7] - model.dof_damping[:7] * v_after[i, :7]  # implicit in the velocity
            raw = (mass @ ((v_after[i] - v[i]) / dt))[:7] + data.qfrc_bias[:7] - passive - command[i]
            filtered[i] = filter_step(filtered[i], raw, dt)
            at = jacobian(q_after[i, :7])
            wrench = hand_wrench(filtered[i], at)
            reached = (
                np.linalg.norm(wrench[:3]),
                np.linalg.norm(hand_wrench(raw, at)[:3]),
                threshold_share(filtered[i], wrench),
            )
            peaks[:, i] = np.maximum(peaks[:, i], reached)
            largest = max(largest, float(np.abs(filtered[i]).max()))
    assert largest > 1.0  # Nm: it has pressed
    np.testing.assert_allclose(physics.forces.filtered.numpy(), filtered, atol=0.03 * largest)
    found = physics.forces.peaks.numpy()
    np.testing.assert_allclose(found[[FORCE, SHARE]], peaks[[0, 2]], rtol=0.01, atol=0.01)
    np.testing.assert_allclose(
        found[RAW], peaks[1], rtol=0.1
    )  # a difference of single-precision velocities, unfiltered


def env_pose(env: Environment):
    return forward_kinematics(env.physics.qpos[:, :7])


def test_a_hand_in_the_air_feels_nothing_and_a_first_touch_has_its_speed():
    env = environment(force_reflex=False)
    position, _ = env_pose(env)
    env.step(-press(1.0))  # upwards
    assert (env.physics.forces.peaks[[FORCE, RAW]] < 1.0).all() and not env.physics.forces.touched.any()
    speeds = torch.zeros(WORLDS)
    for _ in range(8):
        out = env.step(press(1.0))
        speeds = speeds.maximum(out["touch"].speed)
    touched = env.force[1] > 1.0
    assert touched.any() and (speeds[touched] > 0.01).all() and (speeds < 1.0).all()


def test_the_reflex_ends_an_episode_as_a_failure_and_a_new_one_begins_without_force():
    env = environment()
    env.draws.force_margin.fill_(0.02)
    for _ in range(12):
        out = env.step(press(1.0))
        if out["pressed"].any():
            break
    pressed = out["pressed"]
    assert pressed.any() and (out["stopped"] >= pressed).all() and (out["done"] >= pressed).all()
    assert not (out["success"] & pressed).any()
    reward = env.config.reward
    assert (out["terms"]["failure"][pressed] == reward.scale * reward.failure).all()
    env.reset(EVERYONE)
    assert (env.physics.forces.filtered == 0).all() and (env.force == 0).all()


def test_the_force_limit_tightens_with_the_curriculum():
    scales = [force_scale(stage / 10) for stage in range(11)]
    assert scales[0] == LOOSE_FORCE and scales[-1] == 1.0
    assert np.allclose(np.diff(np.log(scales)), np.log(scales[1] / scales[0]))


def test_prices_are_smooth_and_never_more_than_what_finishing_pays():
    forces = torch.linspace(0, 400, 2000)
    price = saturating((forces - FORCE_FREE) / FORCE_SPAN)
    assert (price[forces <= FORCE_FREE] == 0).all() and (price.diff() >= 0).all() and price.diff().max() < 0.02
    assert saturating(torch.ones(1)) == 0.5
    reward = RewardConfig()
    assert -reward.force * 60 < reward.success  # a whole episode of pressing far too hard


@pytest.mark.parametrize(
    "row, pairs", [(FINGER, ["finger-object"]), (BARE, ["housing-object", "link-object"])], ids=["fingertips", "bare"]
)
def test_a_touch_at_the_end_of_a_period_is_one_of_the_period(row, pairs):
    env = environment(force_reflex=False)
    for _ in range(8):
        env.step(press(1.0))
        assert (env.physics.forces.touched[row].bool() >= env.physics.contacts.touching(*pairs)).all()
    assert env.physics.contacts.touching("finger-object").any()
