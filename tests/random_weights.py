"""Untrained networks in a folder of weights, for tests of the graph around them."""

from __future__ import annotations

from pathlib import Path

import torch
from detector_weights import write_detector
from np_policy import weights
from np_policy.networks import PostContactPolicy, PreContactStudent

HAND_DOWN = (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)  # 6D rotation of a hand that points at the table
POSITION = (0.0, 0.0, 0.6)  # of T_E in the range of the student's output: well above the table
OPENING = 0.2


def write_weights(folder: Path, *, domain: str = "card", seed: int = 0, score: float = 3.0) -> Path:
    """Random policies and a random detector. The student is biased to a pose that can be reached; the folder."""
    torch.manual_seed(seed)
    folder.mkdir(parents=True, exist_ok=True)
    student = PreContactStudent()
    last = [module for module in student.modules() if isinstance(module, torch.nn.Linear)][-1]
    with torch.no_grad():
        last.weight.mul_(0.01)
        last.bias.copy_(torch.tensor([*HAND_DOWN, *POSITION, OPENING]))
    weights.save(student, folder / f"pre_contact_{domain}.safetensors")
    weights.save(PostContactPolicy(), folder / f"post_contact_{domain}.safetensors")
    write_detector(folder, score=score, domain=domain, seed=seed)
    return folder
