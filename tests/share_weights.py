"""What processes of torchrun have in common, as each of them says it: SHARE_WEIGHTS OUTPUT."""

import json
import sys
from pathlib import Path

import torch

from np_training.ppo import distributed


def complaint(module: torch.nn.Module) -> str:
    """What `check_same` says; "" for nothing."""
    try:
        distributed.check_same(module)
    except RuntimeError as error:
        return str(error)
    return ""


if __name__ == "__main__":
    distributed.join("cpu")
    first = distributed.rank() == 0
    module = torch.nn.Linear(1, 1)
    torch.nn.init.constant_(module.weight, 1.0 if first else 1.5)
    torch.nn.init.zeros_(module.bias)
    mine = {"steps": 3, "weights": torch.zeros(2)} if first else {"steps": 7, "weights": torch.tensor([1.0, 2.0])}
    state = distributed.furthest(mine, torch.device("cpu"))
    said = {"state": {**state, "weights": state["weights"].tolist()}, "before": complaint(module)}
    distributed.share(module)
    said |= {"after": complaint(module), "weight": float(module.weight)}
    Path(f"{sys.argv[1]}.{distributed.rank()}").write_text(json.dumps(said))
    distributed.leave()
