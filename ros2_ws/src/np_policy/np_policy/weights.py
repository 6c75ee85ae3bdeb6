"""Released weights: safetensors files with a contract in each and a model card beside it."""

from __future__ import annotations

from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file
from safetensors.torch import save as serialise
from torch import nn

from np_description.weights.contract import KEY
from np_description.weights.header import with_metadata
from np_description.weights.released import ENVIRONMENT_VARIABLE, WeightsError, sha256, weights_folder
from np_policy.contract import PolicyContract

__all__ = ["ENVIRONMENT_VARIABLE", "WeightsError", "load", "save", "sha256", "weights_folder"]


def save(module: nn.Module, path: str | Path, contract: PolicyContract, metadata: dict[str, str] | None = None) -> None:
    """Write a module's state to `path` (.safetensors) with its contract and further metadata."""
    state = {name: tensor.detach().cpu().contiguous() for name, tensor in module.state_dict().items()}
    Path(path).write_bytes(with_metadata(serialise(state), {**(metadata or {}), KEY: contract.text()}))


def load(module: nn.Module, path: str | Path, contract: PolicyContract) -> nn.Module:
    """Fill `module` from `path` and return it in evaluation mode.

    contract: what is expected. Raises WeightsError if the file is missing, broken, was trained for something else, or holds
    other tensors than the module. `contract.check` has what is but worth a warning.
    """
    contract.check(path)
    try:
        module.load_state_dict(load_file(str(path)))
    except (SafetensorError, RuntimeError) as error:
        raise WeightsError(f"weights: {path} does not fit {type(module).__name__}: {error}") from error
    return module.eval()
