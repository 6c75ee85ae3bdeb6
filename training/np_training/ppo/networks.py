"""Networks that only training needs: the pre-contact teacher and the critics."""

from __future__ import annotations

import torch
from torch import nn
from torch.distributions import Normal

from np_policy.networks import HIDDEN, PostContactNetwork, mlp
from np_policy.observation import POST_SIZE
from np_training.environment import contact
from np_training.environment.environment import PRIVILEGED_SIZE
from np_training.environment.object_poses import PRE_STATE_SIZE

LOG_STD = -3.0, 0.5  # between which actions are drawn


class PreContactActor(nn.Module):
    """Object and goal pose (n, 18) to the mean contact action (n, 9) in [-1, 1]."""

    def __init__(self) -> None:
        super().__init__()
        self.net = mlp(PRE_STATE_SIZE, HIDDEN, contact.SIZE)
        self.log_std = nn.Parameter(torch.full((contact.SIZE,), -0.7))
        with torch.no_grad():
            self.net[-1].weight.mul_(0.1)
            self.net[-1].bias.zero_()
            self.net[-1].bias[3] = -1.0  # fingers nearly closed
            self.net[-1].bias[8] = 1.0  # more often on the upper face than on the others

    def forward(self, state: torch.Tensor) -> torch.Tensor:
        return torch.tanh(self.net(state))

    @torch.no_grad()
    def act(self, state: torch.Tensor, explore: float) -> tuple[torch.Tensor, torch.Tensor]:
        """A sampled action (n, 9) and its log-probability (n,); a share `explore` of the actions has its object point
        anywhere on the object, so that no face is forgotten because another was learned first."""
        normal = distribution(self, state)
        action = normal.sample()
        elsewhere = torch.rand(len(state), 1, device=state.device) < explore
        direction = torch.nn.functional.normalize(torch.randn_like(action[:, 6:]))
        action[:, 6:] = torch.where(elsewhere, direction, action[:, 6:])
        return action, normal.log_prob(action).sum(-1)


class ActorCritic(nn.Module):
    """The post-contact policy with its critic, and the pre-contact policy with its own."""

    def __init__(self) -> None:
        super().__init__()
        self.post = PostContactNetwork()
        self.post_value = mlp(POST_SIZE + PRIVILEGED_SIZE, HIDDEN, 1)
        self.pre = PreContactActor()
        self.pre_value = mlp(PRE_STATE_SIZE, HIDDEN, 1)


def distribution(policy: nn.Module, state: torch.Tensor) -> Normal:
    """The policy's diagonal Gaussian."""
    return Normal(policy(state), policy.log_std.clamp(*LOG_STD).exp(), validate_args=False)


def sample(policy: nn.Module, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """A sampled action (..., k) and its log-probability (...), for states (..., m)."""
    normal = distribution(policy, state)
    action = normal.sample()
    return action, normal.log_prob(action).sum(-1)
