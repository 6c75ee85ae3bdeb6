"""The batched operational-space law against the controller's, and an episode's target reached under it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from np_common.rotations import matrix_from_vector
from np_control.impedance import STIFFNESS_MAX, STIFFNESS_MIN
from np_control.kinematics import forward_kinematics, pose_distance
from np_control.operational_space import chosen_gains, operational_space_torque
from np_description.domains import BUMP, CARD
from np_description.panda import NOMINAL
from np_policy.action import Target
from np_training.physics.batched import ARM, BatchedPhysics
from np_training.physics.config import PhysicsConfig

WORLDS = 8


def make_target(q: torch.Tensor, generator: torch.Generator, shift: float, turn: float) -> Target:
    position, rotation = forward_kinematics(q)
    position = position + shift * torch.randn(len(q), 3, generator=generator)
    rotation = matrix_from_vector(turn * torch.randn(len(q), 3, generator=generator)) @ rotation
    low, high = (torch.as_tensor(limit, dtype=q.dtype) for limit in (STIFFNESS_MIN, STIFFNESS_MAX))
    stiffness = low + (high - low) * torch.rand(q.shape, generator=generator)
    return Target(position, rotation, stiffness, 0.7 + torch.rand(q.shape, generator=generator))


def mass_matrix(physics: BatchedPhysics) -> np.ndarray:
    """The arm's inertia (worlds, 7, 7) from the simulator's rows of a triangle."""
    rows, packed = physics.host_model.M_rowadr, physics.data.M.numpy()
    full = np.zeros((physics.worlds, 7, 7))
    for i in range(7):
        for j in range(i + 1):
            full[:, i, j] = full[:, j, i] = packed[:, rows[i] + j]
    return full


def test_kernel_and_controller_compute_the_same_torque():
    physics = BatchedPhysics(CARD, WORLDS, "cpu", PhysicsConfig(substeps=1, controller="osc"))
    generator = torch.Generator().manual_seed(1)
    physics.qpos[:, ARM] += 0.2 * torch.randn(WORLDS, 7, generator=generator)
    physics.advance()  # mass matrix and Coriolis terms of this posture
    physics.qvel[:, ARM] = 0.3 * torch.randn(WORLDS, 7, generator=generator)
    q, dq = (a[:, ARM].double().numpy().copy() for a in (physics.qpos, physics.qvel))
    near = physics.qpos[:, ARM].clone()
    postures = [near + 0.05 * torch.randn(WORLDS, 7, generator=generator) for _ in range(2)]
    targets = [make_target(near, generator, 0.02, 0.1) for _ in range(2)]
    for posture, target in zip(postures, targets):
        physics.aim(posture, target)
    physics.delay[: WORLDS // 2] = 1  # these still follow the command of the period before
    physics.delay[WORLDS // 2 :] = 0
    mass, bias, gravity = (
        mass_matrix(physics),
        *(getattr(physics.data, name).numpy()[:, ARM].astype(float) for name in ("qfrc_bias", "qfrc_gravcomp")),
    )
    physics.advance()
    for i in range(WORLDS):
        new = int(i >= WORLDS // 2)
        expected = operational_space_torque(
            q[i],
            dq[i],
            targets[new].position[i].double().numpy(),
            targets[new].rotation[i].double().numpy(),
            postures[new][i].double().numpy(),
            chosen_gains(targets[new].stiffness[i].double().numpy(), targets[new].damping_ratio[i].double().numpy()),
            mass[i],
            bias[i] - gravity[i],
        )
        expected = np.clip(expected, -NOMINAL.torque_limit, NOMINAL.torque_limit)
        np.testing.assert_allclose(physics.ctrl[i, ARM].numpy(), expected, atol=5e-3)
    assert np.abs(expected).max() > 1


def test_the_target_is_reached_and_kept():
    physics = BatchedPhysics(BUMP, WORLDS, "cpu", PhysicsConfig(controller="osc"))
    physics.delay.zero_()
    q = physics.qpos[:, ARM].clone()
    target = make_target(q, torch.Generator().manual_seed(2), 0.02, 0.05)
    middle = torch.as_tensor((STIFFNESS_MIN + STIFFNESS_MAX) / 2, dtype=q.dtype).expand_as(q)
    target = replace(target, stiffness=middle, damping_ratio=torch.ones_like(q))
    for _ in range(12):  # 1.2 s, of a critically damped 2.9 Hz
        physics.aim(q, target)
        physics.advance()
    distance, angle = pose_distance(physics.qpos[:, ARM], target.position, target.rotation)
    before, _ = pose_distance(q, target.position, target.rotation)
    assert before.max() > 0.04
    assert distance.max() < 4e-3 and angle.max() < 2e-2  # what joint friction leaves


def test_an_unknown_controller_is_refused():
    with pytest.raises(ValueError, match="expected one of impedance, osc, got 'pd'"):
        PhysicsConfig(controller="pd")
