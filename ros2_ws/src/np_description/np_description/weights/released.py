"""Folder and names of released weights. No PyTorch: the detector runs without it."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

ENVIRONMENT_VARIABLE = "NP_WEIGHTS"


class WeightsError(ValueError):
    """Weights are missing or do not fit the network; the message names the file and what was expected."""


def weights_folder(folder: str | Path = "") -> Path:
    """The folder with released weights: `folder` if given, $NP_WEIGHTS, or `weights` in a parent of this file
    or of the working directory.

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
    raise WeightsError(
        f"weights: no folder `weights` with safetensors beside the code or the working directory; "
        f"set ${ENVIRONMENT_VARIABLE}, or train with `make train`"
    )


def sha256(path: str | Path) -> str:
    """Hex digest of a file, as model cards and bags name weights."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
