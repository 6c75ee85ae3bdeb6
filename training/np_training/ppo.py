"""Proximal policy optimisation (Schulman et al., 2017), plainly: one function for the loss, one for the advantages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import nn

from np_training.networks import distribution


@dataclass(frozen=True)
class PPOConfig:
    """discount; trace: lambda of generalised advantage estimation; clip; epochs, minibatches a rollout; entropy: weight
    of the bonus; target_kl: the learning rate falls by 1.5 above twice it and rises below half of it; rate: bounds of the
    learning rate."""

    discount: float = 0.98
    trace: float = 0.95
    clip: float = 0.2
    epochs: int = 5
    minibatches: int = 8
    entropy: float = 0.002
    target_kl: float = 0.01
    rate: tuple[float, float] = (2e-5, 1e-3)
    gradient_norm: float = 1.0


def advantages(config: PPOConfig, reward: torch.Tensor, done: torch.Tensor, value: torch.Tensor,
               last_value: torch.Tensor) -> torch.Tensor:
    """Generalised advantages (t, n) of rewards, ends and values (t, n), and the value (n,) after the last step.

    An end is terminal however it came: the critics see the time that remains.
    """
    result = torch.zeros_like(reward)
    running, following = torch.zeros_like(last_value), last_value
    for t in reversed(range(len(reward))):
        alive = (~done[t]).float()
        delta = reward[t] + config.discount * following * alive - value[t]
        running = delta + config.discount * config.trace * alive * running
        result[t], following = running, value[t]
    return result


class Learner:
    """PPO on one policy and its critic, with an optimiser for each and a learning rate steered by the KL divergence."""

    def __init__(self, policy: nn.Module, critic: nn.Module, config: PPOConfig, rate: float = 3e-4) -> None:
        self.policy, self.critic, self.config = policy, critic, config
        self.policy_optimiser = torch.optim.Adam(policy.parameters(), lr=rate, eps=1e-5)
        self.critic_optimiser = torch.optim.Adam(critic.parameters(), lr=5e-4, eps=1e-5)

    @property
    def rate(self) -> float:
        """The policy's learning rate now."""
        return self.policy_optimiser.param_groups[0]["lr"]

    def update(self, state: torch.Tensor, critic_state: torch.Tensor, action: torch.Tensor, log_probability: torch.Tensor,
               advantage: torch.Tensor, returns: torch.Tensor) -> dict[str, float]:
        """Several epochs over one batch, first axis samples; returns the mean of each statistic."""
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-6)
        with torch.no_grad():
            old_mean, old_std = _moments(self.policy, state)
        sums = {"policy_loss": 0.0, "value_loss": 0.0, "kl": 0.0, "entropy": 0.0}
        count = 0
        for rows in _minibatches(len(state), self.config, state.device):
            normal = distribution(self.policy, state[rows])
            ratio = (normal.log_prob(action[rows]).sum(-1) - log_probability[rows]).exp()
            gain = advantage[rows]
            clipped = ratio.clamp(1 - self.config.clip, 1 + self.config.clip)
            entropy = normal.entropy().sum(-1).mean()
            policy_loss = -torch.minimum(ratio * gain, clipped * gain).mean() - self.config.entropy * entropy
            value_loss = (self.critic(critic_state[rows])[:, 0] - returns[rows]).square().mean()
            with torch.no_grad():
                ratio_std = normal.scale / old_std
                kl = (0.5 * (ratio_std**2 + ((normal.mean - old_mean[rows]) / old_std) ** 2 - 1) - ratio_std.log())
                kl = kl.sum(-1).mean().item()
            self._steer(kl)
            for loss, optimiser, module in ((policy_loss, self.policy_optimiser, self.policy),
                                            (value_loss, self.critic_optimiser, self.critic)):
                optimiser.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(module.parameters(), self.config.gradient_norm)
                optimiser.step()
            for name, value in (("policy_loss", policy_loss), ("value_loss", value_loss), ("entropy", entropy)):
                sums[name] += value.detach()
            sums["kl"] += kl
            count += 1
        return {name: float(total) / count for name, total in sums.items()}

    def _steer(self, kl: float) -> None:
        low, high = self.config.rate
        factor = 1 / 1.5 if kl > 2 * self.config.target_kl else 1.5 if 0 < kl < self.config.target_kl / 2 else 1.0
        for group in self.policy_optimiser.param_groups:
            group["lr"] = min(max(group["lr"] * factor, low), high)

    def state_dict(self) -> dict:
        """Optimiser states; the networks are saved by their owner."""
        return {"policy": self.policy_optimiser.state_dict(), "critic": self.critic_optimiser.state_dict()}

    def load_state_dict(self, state: dict) -> None:
        """Restore what `state_dict` gave."""
        self.policy_optimiser.load_state_dict(state["policy"])
        self.critic_optimiser.load_state_dict(state["critic"])


def _moments(policy: nn.Module, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    normal = distribution(policy, state)
    return normal.mean, normal.scale[0].clone()


def _minibatches(count: int, config: PPOConfig, device: torch.device) -> Iterator[torch.Tensor]:
    for _ in range(config.epochs):
        yield from torch.randperm(count, device=device).chunk(config.minibatches)
