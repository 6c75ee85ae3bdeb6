"""Trained weights as a network of ONNX Runtime, with their contract and sha256, that gives the same output."""

from __future__ import annotations

import json
import logging
import warnings
from pathlib import Path

import onnx
import torch
from safetensors import safe_open
from torch import Tensor, nn

from np_description.camera import CAMERA
from np_description.domains import find_domain
from np_description.weights.contract import KEY
from np_description.weights.released import WeightsError, sha256
from np_perception.contract import DetectorContract
from np_perception.detector import KeypointDetector
from np_training.detector.network import KeypointNetwork, NetworkConfig

AGREEMENT = 0.02  # px and score; sums in another order differ by less


class Deployed(nn.Module):
    """What a node calls: image (1, height, width, 3) uint8 to pixels (1, 8, 2) and scores (1, 8)."""

    def __init__(self, network: KeypointNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels u, v and scores in [0, 1]."""
        found = self.network(image.permute(0, 3, 1, 2).float() / 255)
        return found.pixels, found.score_logits.sigmoid()


def load_weights(path: Path) -> tuple[KeypointNetwork, dict]:
    """The trained network in evaluation mode, and its training record.

    Raises WeightsError if the file is missing, is not one that np_training.detector.train wrote, or was trained for
    something else (DetectorContract).
    """
    if not path.is_file():
        raise WeightsError(f"detector: expected the weights {path}, which do not exist")
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata() or {}
        state = {name: file.get_tensor(name) for name in file.keys()}
    if not {"network", "training"} <= metadata.keys():
        raise WeightsError(f"detector: {path}: expected metadata network and training, got {sorted(metadata)}")
    config = {key: tuple(v) if isinstance(v, list) else v for key, v in json.loads(metadata["network"]).items()}
    network = KeypointNetwork(NetworkConfig(**config))
    network.load_state_dict(state)
    record = json.loads(metadata["training"])
    DetectorContract.of(find_domain(record["domain"])).compare(metadata.get(KEY), path)
    return network.eval(), record


def export(weights: Path) -> Path:
    """Write the .onnx beside `weights` (.safetensors) and return its path. Raises WeightsError if their
    outputs differ."""
    network, record = load_weights(weights)
    module = Deployed(network).eval()
    example = torch.randint(
        0, 256, (1, CAMERA.height, CAMERA.width, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0)
    )
    target = weights.with_suffix(".onnx")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter, about its own parts
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        program = torch.onnx.export(
            module, (example,), dynamo=True, input_names=["image"], output_names=["pixels", "scores"], verbose=False
        )
    model = program.model_proto
    contract = DetectorContract.of(find_domain(record["domain"]))
    onnx.helper.set_model_props(model, {KEY: contract.text(), "weights_sha256": sha256(weights)})
    for node in model.graph.node:  # the exporter notes source lines there
        del node.metadata_props[:]
        node.doc_string = ""
    onnx.save(model, target)
    with torch.no_grad():
        pixels, scores = module(example)
    found = KeypointDetector(find_domain(record["domain"]), weights.parent).detect(example[0].numpy())
    difference = max(abs(found.pixels - pixels[0].numpy()).max(), abs(found.scores - scores[0].numpy()).max())
    if difference > AGREEMENT:
        raise WeightsError(f"detector: {target} differs from {weights} by {difference:.3g} px, expected {AGREEMENT}")
    return target
