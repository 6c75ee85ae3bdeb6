"""Where tensors live: on a GPU, where there is one."""

from __future__ import annotations

DEVICE_HELP = "default: cuda where PyTorch finds a GPU, else cpu"


def usable(device: str | None) -> str:
    """The device named, or that of `DEVICE_HELP` where none is."""
    import torch  # slow, and a command line is read without it

    return device or ("cuda" if torch.cuda.is_available() else "cpu")
