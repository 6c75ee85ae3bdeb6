"""A policy's safetensors file, run by PyTorch on one sample: equal inputs give equal bits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from np_description.domains import Task
from np_policy import weights
from np_policy.contract import POST_CONTACT, PRE_CONTACT, PolicyContract
from np_policy.network_input import post_contact_input, pre_contact_input
from np_policy.networks import PostContactNetwork, PreContactNetwork

NETWORKS = {PRE_CONTACT: PreContactNetwork, POST_CONTACT: PostContactNetwork}
NETWORK_INPUTS = {PRE_CONTACT: pre_contact_input, POST_CONTACT: post_contact_input}


def load_network(path: str | Path, kind: str, domain: Task, contract: PolicyContract) -> Callable[..., np.ndarray]:
    """The network as a function of what is measured, in the order of its function of `np_policy.network_input`.

    Raises WeightsError where the file does not fit the contract that is expected.
    """
    network = weights.load(NETWORKS[kind](), path, contract)

    def run(*inputs) -> np.ndarray:
        state = NETWORK_INPUTS[kind](domain, *(np.asarray(value, float) for value in inputs))
        with torch.inference_mode():
            return network(torch.from_numpy(state.astype(np.float32))).numpy().astype(float)

    return run
