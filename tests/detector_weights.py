"""A tiny detector with random weights, exported like a trained one, for tests of what surrounds the
network."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import torch
from np_training.detector.export import export
from np_training.detector.network import KeypointNetwork, NetworkConfig
from safetensors.torch import save_file

TINY = NetworkConfig(widths=(8, 8, 8), blocks=(1, 1))


def write_detector(folder: Path, *, score: float = 0.0, domain: str = "card", seed: int = 0) -> Path:
    """Weights and network of a detector in `folder`; `score` is the logit around which its scores lie. The
    .onnx's path."""
    torch.manual_seed(seed)
    network = KeypointNetwork(TINY)
    with torch.no_grad():
        network.score.bias.fill_(score)
        network.score.weight.mul_(0.1)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"keypoint_detector_{domain}.safetensors"
    save_file(network.state_dict(), path, metadata={"network": json.dumps(asdict(TINY)),
                                                    "training": json.dumps({"domain": domain, "seed": seed})})
    return export(path)
