"""How long the detector takes for one image, as the node runs it and as the plain torch module."""

from __future__ import annotations

import numpy as np
import torch

from np_common.timing import milliseconds
from np_description.domains import Task
from np_description.weights.released import weights_folder
from np_perception.detector import IMAGE_SHAPE, KeypointDetector, network_name
from np_training.detector.exporting import Deployed, load_weights


def detector_figures(domain: Task, weights: str) -> dict[str, object]:
    """The detector as the node runs it (ONNX Runtime, one thread) against the plain torch module."""
    detector = KeypointDetector(domain, weights)
    image = np.random.default_rng(0).integers(0, 256, IMAGE_SHAPE, dtype=np.uint8)
    figures: dict[str, object] = milliseconds(lambda: detector.detect(image), 50)
    torch.set_num_threads(1)
    network, _ = load_weights(weights_folder(weights) / f"{network_name(domain)}.safetensors")
    module, tensor = Deployed(network).eval(), torch.from_numpy(image[None])

    def plain():
        with torch.inference_mode():
            module(tensor)

    peer = milliseconds(plain, 50)
    return {**figures, "peer": "the torch module, one thread", **{f"peer_{k}": v for k, v in peer.items()}}
