"""A tiny detector with random weights, exported like a trained one, for tests of what surrounds the network.

To export takes seconds: each is made once by all workers of a run, which have the folder `SHARED` in common.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from safetensors.torch import save_file

from np_description.domains import find_domain
from np_description.weights.contract import KEY
from np_perception.contract import DetectorContract
from np_training.detector.exporting import export
from np_training.detector.network import KeypointNetwork, NetworkConfig

SHARED = "NP_TESTS_SHARED"  # the variable of the environment that names it
TINY = NetworkConfig(widths=(8, 8, 8), blocks=(1, 1))


def write_detector(folder: Path, *, score: float = 3.0, domain: str = "card", seed: int = 0) -> Path:
    """Weights and network of a detector in `folder`; `score` is the logit around which its scores lie. The
    .onnx's path."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in _files(score, domain, seed).items():
        (folder / name).write_bytes(content)
    return folder / f"keypoint_detector_{domain}.onnx"


@cache
def _files(score: float, domain: str, seed: int) -> dict[str, bytes]:
    """Names and contents."""
    made = Path(os.environ[SHARED]) / f"detector_{domain}_{seed}_{score:g}"
    if not made.exists():
        with TemporaryDirectory(dir=made.parent) as folder:
            _export(Path(folder), score, domain, seed)
            try:
                Path(folder).rename(made)
            except OSError:  # another worker's was there first
                pass
            Path(folder).mkdir(exist_ok=True)  # to be removed
    return {file.name: file.read_bytes() for file in made.iterdir()}


def _export(folder: Path, score: float, domain: str, seed: int) -> None:
    torch.manual_seed(seed)
    network = KeypointNetwork(TINY)
    with torch.no_grad():
        network.score.bias.fill_(score)
        network.score.weight.mul_(0.1)
    path = folder / f"keypoint_detector_{domain}.safetensors"
    record = {"network": asdict(TINY), "training": {"domain": domain, "seed": seed}}
    metadata = {key: json.dumps(value) for key, value in record.items()}
    metadata[KEY] = DetectorContract.of(find_domain(domain)).text()
    save_file(network.state_dict(), path, metadata=metadata)
    export(path)
