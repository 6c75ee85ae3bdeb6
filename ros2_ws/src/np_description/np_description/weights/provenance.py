"""Provenance of a run: revision of the code and hashes of the weights."""

from __future__ import annotations

import subprocess
from pathlib import Path

from np_description.weights.released import WeightsError, sha256, weights_folder


def origin(weights: str = "") -> dict[str, object]:
    """Provenance of a run: git revision ("" outside a working tree), SHA-256 of every released weight."""
    command = [
        "git",
        "-C",
        str(Path(__file__).resolve().parent),
        "describe",
        "--always",
        "--dirty",
        "--abbrev=12",
    ]
    try:
        revision = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        revision = ""
    try:
        folder = weights_folder(weights)
        files = sorted([*folder.glob("*.safetensors"), *folder.glob("*.onnx")])
        hashes = {path.name: sha256(path) for path in files}
    except WeightsError:
        hashes = {}  # the nodes that need them report it
    return {"revision": revision, "weights_sha256": hashes}
