"""Proximal policy optimisation (Schulman et al., 2017), plainly: advantages, and one update."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import torch
from torch import nn

from np_training.ppo import distributed
from np_training.ppo.captured import Captured
from np_training.ppo.config import PPOConfig
from np_training.ppo.networks import distribution

STATISTICS = ("policy_loss", "value_loss", "kl", "entropy")
GRAIN = 2048  # rows: what minibatches are filled up to a multiple of where they are captured, to have few shapes
LARGEST_LOG_RATIO = 20.0  # of two probabilities of an action


def advantages(
    config: PPOConfig, reward: torch.Tensor, done: torch.Tensor, value: torch.Tensor, last_value: torch.Tensor
) -> torch.Tensor:
    """Generalised advantages (t, n) of rewards, ends and values (t, n), and the value (n,) after the last
    step.

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


@dataclass(frozen=True)
class PolicySamples:
    """Samples (n, ...): the policy's observation, its critic's, the action and its probability (n,), how much better
    than expected it went (n,) and what came of it (n,)."""

    state: torch.Tensor
    critic_state: torch.Tensor
    action: torch.Tensor
    log_probability: torch.Tensor
    advantage: torch.Tensor
    returns: torch.Tensor

    def columns(self) -> list[torch.Tensor]:
        """The tensors, in the order of the fields."""
        return [getattr(self, field.name) for field in fields(self)]


class Learner:
    """PPO on one policy and its critic, with an optimiser for each and a learning rate steered by the KL
    divergence."""

    def __init__(self, policy: nn.Module, critic: nn.Module, config: PPOConfig, rate: float = 3e-4) -> None:
        self.policy, self.critic, self.config = policy, critic, config
        # A rate on the device is steered there, without waiting for what has been computed so far.
        device = next(policy.parameters()).device
        rate = torch.tensor(rate, device=device)
        self._captures = device.type == "cuda"
        self._options = {"eps": 1e-5, "fused": True, "capturable": self._captures}
        self.policy_optimiser = torch.optim.Adam(policy.parameters(), lr=rate, **self._options)
        self.critic_optimiser = torch.optim.Adam(critic.parameters(), lr=5e-4, **self._options)
        self._sums = torch.zeros(len(STATISTICS), device=device)
        self._parameters = [*policy.parameters(), *critic.parameters()]
        # What is reckoned from a minibatch is one message; that between processes stays outside of what is captured.
        self._message = torch.zeros(len(STATISTICS) + sum(p.numel() for p in self._parameters), device=device)
        self._reckon, self._step = Captured(self._gradients), Captured(self._descend)

    @property
    def rate(self) -> float:
        """The policy's learning rate now."""
        return float(self._rate)

    @rate.setter
    def rate(self, rate: float) -> None:
        self._rate.fill_(rate)

    @property
    def _rate(self) -> torch.Tensor:
        return self.policy_optimiser.param_groups[0]["lr"]

    def update(self, batch: PolicySamples) -> dict[str, float]:
        """Several epochs over one batch; returns the mean of each statistic.

        With several processes the batch is the union of theirs, which may differ in length: losses are sums
        divided by the number of samples of all, so that gradients summed over the processes are those of one
        large batch.
        """
        batch, count, device = (
            replace(batch, advantage=_normalised(batch.advantage)),
            len(batch.state),
            batch.state.device,
        )
        with torch.no_grad():
            old_mean, old_std = _moments(self.policy, batch.state)
        self._sums.zero_()
        sizes = torch.tensor(
            [len(rows) for rows in torch.arange(count).tensor_split(self.config.minibatches)],
            dtype=torch.float32,
            device=device,
        )
        distributed.add(sizes)
        sizes = sizes.tolist()
        columns = *batch.columns(), old_mean
        for number, rows in enumerate(_minibatches(count, self.config, device)):
            share = torch.full((len(rows),), 1 / max(sizes[number % len(sizes)], 1.0), device=device)
            if self._captures:
                missing = -len(rows) % GRAIN
                rows, share = (nn.functional.pad(column, (0, missing)) for column in (rows, share))
            self._reckon(*(column[rows] for column in columns), old_std, share)
            distributed.add(self._message)
            self._step(self._message)
        return dict(zip(STATISTICS, (self._sums / (number + 1)).tolist()))

    def _gradients(self, *tensors: torch.Tensor) -> None:
        """The message of a step: statistics and gradients of the columns of a batch (n, ...), the policy's means (n, k) and deviation
        (1, k) before the first step, and the share (n,) by which each row counts."""
        *columns, old_mean, old_std, share = tensors
        batch = PolicySamples(*columns)
        normal = distribution(self.policy, batch.state)
        # Far beyond the clip the ratio has no effect, and exp would overflow: infinity times an advantage of 0 is NaN.
        log_ratio = normal.log_prob(batch.action).sum(-1) - batch.log_probability
        ratio = log_ratio.clamp(-LARGEST_LOG_RATIO, LARGEST_LOG_RATIO).exp()
        clipped = ratio.clamp(1 - self.config.clip, 1 + self.config.clip)
        entropy = (share * normal.entropy().sum(-1)).sum()
        policy_loss = (
            -(share * torch.minimum(ratio * batch.advantage, clipped * batch.advantage)).sum()
            - self.config.entropy * entropy
        )
        value_loss = (share * (self.critic(batch.critic_state).flatten() - batch.returns).square()).sum()
        with torch.no_grad():
            ratio_std = normal.scale / old_std
            kl = 0.5 * (ratio_std**2 + ((normal.mean - old_mean) / old_std) ** 2 - 1) - ratio_std.log()
            statistics = torch.stack([policy_loss, value_loss, (share * kl.sum(-1)).sum(), entropy])
        gradients = torch.autograd.grad(policy_loss + value_loss, self._parameters)
        torch.cat([statistics, *(gradient.reshape(-1) for gradient in gradients)], out=self._message)

    def _descend(self, message: torch.Tensor) -> None:
        """One step by the message of all processes."""
        statistics, *gradients = message.split([len(STATISTICS), *(p.numel() for p in self._parameters)])
        for parameter, gradient in zip(self._parameters, gradients):
            parameter.grad = gradient.view_as(parameter)
        self._steer(statistics[STATISTICS.index("kl")])
        for optimiser, module in ((self.policy_optimiser, self.policy), (self.critic_optimiser, self.critic)):
            nn.utils.clip_grad_norm_(module.parameters(), self.config.gradient_norm)
            optimiser.step()
        self._sums += statistics

    def _steer(self, kl: torch.Tensor) -> None:
        target, factor = self.config.target_kl, torch.ones_like(self._rate)
        factor = torch.where(kl > 2 * target, factor / 1.5, factor)
        factor = torch.where((kl > 0) & (kl < target / 2), factor * 1.5, factor)
        self._rate.mul_(factor).clamp_(*self.config.rate)

    def state_dict(self) -> dict:
        """Optimiser states; the networks are saved by their owner."""
        return {"policy": self.policy_optimiser.state_dict(), "critic": self.critic_optimiser.state_dict()}

    def load_state_dict(self, state: dict) -> None:
        """Restore what `state_dict` gave; of a released checkpoint, which has no optimisers, the learning rate."""
        self.rate = learning_rate(state)
        if "rate" in state:
            return
        rate = self._rate
        for name, optimiser in (("policy", self.policy_optimiser), ("critic", self.critic_optimiser)):
            groups = [group | self._options for group in state[name]["param_groups"]]
            optimiser.load_state_dict(state[name] | {"param_groups": groups})
        self.policy_optimiser.param_groups[0]["lr"] = rate
        self._step = Captured(self._descend)  # what was captured had the optimisers' memory of before


def learning_rate(state: dict) -> float:
    """The policy's learning rate in what `Learner.state_dict` gave, or in what a release has left of it (`rate` alone)."""
    return float(state["rate"] if "rate" in state else state["policy"]["param_groups"][0]["lr"])


def _normalised(advantage: torch.Tensor) -> torch.Tensor:
    """Advantages (n,) less their mean, over their deviation, both over all processes."""
    sums = torch.stack([torch.tensor(float(len(advantage)), device=advantage.device), advantage.sum()])
    distributed.add(sums)
    mean = sums[1] / sums[0]
    spread = (advantage - mean).square().sum()
    distributed.add(spread)
    return (advantage - mean) / ((spread / sums[0]).sqrt() + 1e-6)


def _moments(policy: nn.Module, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    normal = distribution(policy, state)
    return normal.mean, normal.scale[:1].clone()  # one row: the deviation does not depend on the state


def _minibatches(count: int, config: PPOConfig, device: torch.device) -> Iterator[torch.Tensor]:
    for _ in range(config.epochs):
        yield from torch.randperm(count, device=device).tensor_split(config.minibatches)
