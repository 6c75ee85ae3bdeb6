"""Reading what a training run has saved."""

from __future__ import annotations

import pickle
from pathlib import Path
from zipfile import BadZipFile

import torch


class CheckpointError(ValueError):
    """A file that is missing or is no checkpoint of a training run; one line that names it, what was expected and what came."""


def read_state(path: Path, place: str | torch.device) -> dict:
    """What a training run saved in `path`, tensors on `place`. Raises CheckpointError."""
    try:
        state = torch.load(path, map_location=place, weights_only=True)
    except OSError as error:
        raise CheckpointError(f"{path}: expected a checkpoint of np_training.train, got: {error.strerror}") from error
    except (RuntimeError, pickle.UnpicklingError, EOFError, BadZipFile) as error:
        first = str(error).strip().partition("\n")[0][:120]
        raise CheckpointError(f"{path}: expected a checkpoint of np_training.train, cannot read it: {first}") from error
    if not isinstance(state, dict) or "networks" not in state:
        found = ", ".join(map(str, state)) if isinstance(state, dict) else type(state).__name__
        raise CheckpointError(f"{path}: expected a checkpoint with networks, got {found[:120] or 'nothing'}")
    return state
