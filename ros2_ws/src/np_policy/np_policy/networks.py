"""The networks: plain multilayer perceptrons, the same modules in training and deployment."""

from __future__ import annotations

import torch
from torch import nn

from np_policy import action, hand_pose, observation

HIDDEN = (512, 256, 128)


def mlp(inputs: int, hidden: tuple[int, ...], outputs: int) -> nn.Sequential:
    """Linear layers with ELU between them."""
    sizes, layers = (inputs, *hidden), []
    for a, b in zip(sizes, sizes[1:]):
        layers += [nn.Linear(a, b), nn.ELU()]
    return nn.Sequential(*layers, nn.Linear(sizes[-1], outputs))


class PostContactNetwork(nn.Module):
    """Observation (..., 79) to the mean action (..., 20) in [-1, 1]; `log_std` (20,) is used in training only."""

    def __init__(self) -> None:
        super().__init__()
        self.net = mlp(observation.POST_SIZE, HIDDEN, action.SIZE)
        self.log_std = nn.Parameter(torch.full((action.SIZE,), -0.7))
        with torch.no_grad():
            self.net[-1].weight.mul_(0.1)
            self.net[-1].bias.zero_()

    def forward(self, state: torch.Tensor) -> torch.Tensor:
        return torch.tanh(self.net(state))


class PreContactNetwork(nn.Module):
    """Keypoints and goal (..., 32) to a hand pose (..., 10), see np_policy.hand_pose."""

    def __init__(self) -> None:
        super().__init__()
        self.net = mlp(observation.STUDENT_SIZE, HIDDEN, hand_pose.SIZE)

    def forward(self, state: torch.Tensor) -> torch.Tensor:
        return self.net(state)
