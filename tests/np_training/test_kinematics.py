"""The simulator's kinematics in Warp against the controller's, row by row."""

import torch

from np_common.rotations import matrix_from_vector
from np_control import kinematics as reference
from np_description.panda import NOMINAL
from np_training.physics import batched_kinematics as kinematics

ROWS = 200


def postures(generator: torch.Generator) -> torch.Tensor:
    lower, upper = (
        torch.tensor(limit, dtype=torch.float32) for limit in (NOMINAL.position_lower, NOMINAL.position_upper)
    )
    return lower + (upper - lower) * torch.rand(ROWS, 7, generator=generator)


def test_forward_kinematics_of_a_slice_of_the_state():
    generator = torch.Generator().manual_seed(1)
    state = torch.zeros(ROWS, 16)
    state[:, :7] = postures(generator)
    position, rotation = kinematics.forward_kinematics(state[:, :7])
    expected = reference.forward_kinematics(state[:, :7].double())
    assert (position - expected[0]).abs().max() < 2e-6 and (rotation - expected[1]).abs().max() < 2e-6


def test_inverse_kinematics_takes_the_same_steps():
    generator = torch.Generator().manual_seed(2)
    q = torch.tensor(NOMINAL.ready, dtype=torch.float32) + 0.3 * torch.randn(ROWS, 7, generator=generator)
    position, rotation = kinematics.forward_kinematics(q)
    position = position + 0.03 * torch.randn(ROWS, 3, generator=generator)
    rotation = matrix_from_vector(0.1 * torch.randn(ROWS, 3, generator=generator)) @ rotation
    for iterations in (1, 3, 30):
        found = kinematics.solve_ik(q, position, rotation, iterations=iterations)
        expected = reference.solve_ik(q.double(), position.double(), rotation.double(), iterations=iterations)
        assert (found - expected).abs().max() < 2e-4


def test_out_of_reach_the_solution_is_within_the_limits():
    generator = torch.Generator().manual_seed(3)
    q = postures(generator)
    position = torch.randn(ROWS, 3, generator=generator) * 2
    rotation = matrix_from_vector(torch.randn(ROWS, 3, generator=generator))
    found = kinematics.solve_ik(q, position, rotation, iterations=20)
    assert torch.isfinite(found).all()
    assert (found >= torch.tensor(NOMINAL.position_lower) - 1e-6).all()
    assert (found <= torch.tensor(NOMINAL.position_upper) + 1e-6).all()


def test_no_rows_give_no_rows():
    position, rotation = kinematics.forward_kinematics(torch.zeros(0, 7))
    assert position.shape == (0, 3) and rotation.shape == (0, 3, 3)
    assert kinematics.solve_ik(torch.zeros(0, 7), position, rotation).shape == (0, 7)
