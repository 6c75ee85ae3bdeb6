"""The network of a policy's ONNX file as a function, without PyTorch."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from np_description.domains import Task
from np_description.weights.released import WeightsError
from np_policy.onnx.runtime import open_session
from np_policy.onnx.signature import BOX, NETWORK_OUTPUT, SIGNATURES


def load_network(path: str | Path, kind: str, domain: Task) -> Callable[..., np.ndarray]:
    """The network of a checked file as a function of the graph's inputs, without the leading axis, in their order.

    Raises WeightsError for a file with other inputs, and for one whose order of keypoints holds for another box than the
    domain's: where faces are interchangeable the graph has the box built in.
    """
    session = open_session(path)
    names = [each.name for each in session.get_inputs()]
    if names != list(SIGNATURES[kind].inputs):
        raise WeightsError(f"policy: {path}: expected the inputs {list(SIGNATURES[kind].inputs)}, got {names}")
    box = json.loads(session.get_modelmeta().custom_metadata_map[BOX])
    if domain.interchangeable and not np.allclose(box, domain.half_size, rtol=0, atol=1e-6):
        raise WeightsError(
            f"policy: {path} was exported for a box of half sizes {box} m, expected {list(domain.half_size)}; "
            "use the .safetensors, which fit any size"
        )

    def run(*inputs) -> np.ndarray:
        feed = {name: np.asarray(value, float)[None] for name, value in zip(names, inputs, strict=True)}
        return session.run([NETWORK_OUTPUT[kind]], feed)[0][0]

    return run
