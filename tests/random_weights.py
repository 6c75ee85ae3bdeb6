"""Untrained networks in a folder of weights, for tests of the graph around them."""

from __future__ import annotations

from pathlib import Path

from detector_weights import write_detector
from policy_weights import write_policies

from np_description.domains import CARD


def write_weights(folder: Path) -> Path:
    """Policies and a detector for the card; the student wants a pose that can be reached. The folder."""
    write_policies(folder, CARD)
    write_detector(folder)
    return folder
