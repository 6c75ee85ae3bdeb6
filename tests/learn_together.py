"""What processes of torchrun do together, as each of them says it: LEARN_TOGETHER INPUT OUTPUT.

PPO updates, each on rows of a file that are shared out over the processes; then a checkpoint of which they have different
ones, and weights that differ.
"""

import json
import sys
from pathlib import Path

import torch

from np_policy.networks import mlp
from np_training.ppo import distributed
from np_training.ppo.config import PPOConfig
from np_training.ppo.learner import Learner, PolicySamples
from np_training.ppo.networks import PreContactActor


def learn(batch: tuple[torch.Tensor, ...]) -> tuple[dict, dict, float]:
    """Weights of policy and critic after an update, its statistics, and the learning rate."""
    torch.manual_seed(0)
    policy = PreContactActor()
    critic = mlp(18, (32,), 1)
    learner = Learner(policy, critic, PPOConfig(epochs=3, minibatches=1))
    statistics = learner.update(PolicySamples(*batch))
    return {**policy.state_dict(), **critic.state_dict()}, statistics, learner.rate


def complaint(module: torch.nn.Module) -> str:
    """What `check_same` says; "" for nothing."""
    try:
        distributed.check_same(module)
    except RuntimeError as error:
        return str(error)
    return ""


def shared() -> dict[str, object]:
    """What a process has of the others: the furthest checkpoint, what it says of weights before and after they are shared, one of them."""
    first = distributed.rank() == 0
    module = torch.nn.Linear(1, 1)
    torch.nn.init.constant_(module.weight, 1.0 if first else 1.5)
    torch.nn.init.zeros_(module.bias)
    mine = {"steps": 3, "weights": torch.zeros(2)} if first else {"steps": 7, "weights": torch.tensor([1.0, 2.0])}
    state = distributed.furthest(mine, torch.device("cpu"))
    said = {"state": {**state, "weights": state["weights"].tolist()}, "before": complaint(module)}
    distributed.share(module)
    number, device = float(distributed.rank()), torch.device("cpu")
    decided = [distributed.any_of(condition, device) for condition in (not first, False)]
    said |= {"decided": decided, "total": distributed.total({"number": number + 1, "one": torch.tensor(1)}, device)}
    return {**said, "after": complaint(module), "weight": float(module.weight)}


if __name__ == "__main__":
    distributed.join("cpu")
    out = f"{sys.argv[2]}.{distributed.rank()}"
    batches = torch.load(sys.argv[1], weights_only=True)
    torch.save([learn(parts[distributed.rank()]) for parts in batches], out)
    Path(f"{out}.json").write_text(json.dumps(shared()))
    distributed.leave()
