"""Where tensors live: on a GPU, where there is one."""

from __future__ import annotations

DEVICE_HELP = "default: cuda where PyTorch finds a GPU, else cpu"


def usable(device: str | None) -> str:
    """The device named, or that of `DEVICE_HELP` where none is. Ends the command where it is a GPU and PyTorch finds none."""
    import torch  # slow, and a command line is read without it

    if device and device.startswith("cuda") and not torch.cuda.is_available():
        raise SystemExit(f"--device: expected cpu, since PyTorch finds no GPU, got {device}")
    return device or ("cuda" if torch.cuda.is_available() else "cpu")
