"""Released weights: safetensors files with a model card beside each."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

ENVIRONMENT_VARIABLE = "NP_WEIGHTS"


class WeightsError(RuntimeError):
    """Weights are missing or do not fit the network; the message names the file and what was expected."""


def weights_folder(folder: str | Path = "") -> Path:
    """The folder with released weights: `folder` if given, $NP_WEIGHTS, or `weights` in a parent of this file or of
    the working directory.

    Raises WeightsError if there is none.
    """
    if folder or os.environ.get(ENVIRONMENT_VARIABLE):
        found = Path(folder or os.environ[ENVIRONMENT_VARIABLE])
        if not found.is_dir():
            raise WeightsError(f"weights: expected a folder, got {found}")
        return found
    starts = [Path(__file__).resolve(), Path.cwd() / "_"]
    for parent in (p for start in starts for p in start.parents):
        if (parent / "weights").is_dir() and any((parent / "weights").glob("*.safetensors")):
            return parent / "weights"
    raise WeightsError(f"weights: no folder `weights` with safetensors beside the code or the working directory; "
                       f"set ${ENVIRONMENT_VARIABLE}, or train with `make train`")


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


def sha256(path: str | Path) -> str:
    """Hex digest of a file, as model cards and bags name weights."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
