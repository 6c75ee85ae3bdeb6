"""Released weights: safetensors files with a model card beside each."""

from __future__ import annotations

from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from np_description.released import ENVIRONMENT_VARIABLE, WeightsError, sha256, weights_folder

__all__ = ["ENVIRONMENT_VARIABLE", "WeightsError", "load", "save", "sha256", "weights_folder"]


def save(module: nn.Module, path: str | Path, metadata: dict[str, str] | None = None) -> None:
    """Write a module's state to `path` (.safetensors) with string metadata."""
    state = {name: tensor.detach().cpu().contiguous() for name, tensor in module.state_dict().items()}
    save_file(state, str(path), metadata=metadata)


def load(module: nn.Module, path: str | Path) -> nn.Module:
    """Fill `module` from `path` and return it in evaluation mode.

    Raises WeightsError if the file is missing, broken, or holds other tensors than the module.
    """
    path = Path(path)
    if not path.is_file():
        raise WeightsError(f"weights: expected the file {path}, which does not exist; `make train` writes it")
    try:
        module.load_state_dict(load_file(str(path)))
    except (SafetensorError, RuntimeError) as error:
        raise WeightsError(f"weights: {path} does not fit {type(module).__name__}: {error}") from error
    return module.eval()
