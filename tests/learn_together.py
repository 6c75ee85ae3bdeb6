"""PPO updates, each on rows of a file shared out over the processes of torchrun: LEARN_TOGETHER INPUT OUTPUT."""

import sys

import torch

from np_policy.networks import mlp
from np_training.ppo import distributed
from np_training.ppo.config import PPOConfig
from np_training.ppo.learner import Batch, Learner
from np_training.ppo.networks import PreContactPolicy


def learn(batch: tuple[torch.Tensor, ...]) -> tuple[dict, dict, float]:
    """Weights of policy and critic after an update, its statistics, and the learning rate."""
    torch.manual_seed(0)
    policy = PreContactPolicy()
    critic = mlp(18, (32,), 1)
    learner = Learner(policy, critic, PPOConfig(epochs=3, minibatches=1))
    statistics = learner.update(Batch(*batch))
    return {**policy.state_dict(), **critic.state_dict()}, statistics, learner.rate


if __name__ == "__main__":
    distributed.join("cpu")
    batches = torch.load(sys.argv[1], weights_only=True)
    results = [learn(shared[distributed.rank()]) for shared in batches]
    torch.save(results, f"{sys.argv[2]}.{distributed.rank()}")
    distributed.leave()
